# Owns RECT's router as a service of NixOS: `services.rect-router`. The unit itself is packaging/systemd's, with what it
# may and may not do; here is only what NixOS has elsewhere.
#
#   services.rect-router = { enable = true; robot = "wombat-1"; members = [ "alice" ]; };
{
  config,
  lib,
  pkgs,
  utils,
  ...
}:
let
  inherit (lib)
    literalExpression
    mkDefault
    mkEnableOption
    mkIf
    mkMerge
    mkOption
    types
    ;

  cfg = config.services.rect-router;

  # As the router reads them: longer ones do not fit into a Bluetooth advertisement.
  name = types.strMatching "[A-Za-z0-9._-]{1,29}";

  # Not in the Nix store, which everybody can read: a Nix path, which would be copied there, is refused too.
  secretPath = types.pathWith {
    absolute = true;
    inStore = false;
  };

  # What `rect-router init` makes of the shipped configuration. By text, because nothing in Nix reads JSON5 and the
  # program does not run where a robot's system is built on another processor.
  shipped =
    if cfg.baseStation then
      {
        file = ../../config/base-station.json5;
        name = "base-station";
      }
    else
      {
        file = ../../config/robot.json5;
        name = "wombat-1";
      };
  generated = pkgs.writeText "rect-router.json5" (
    lib.replaceStrings
      [
        shipped.name
        "\"rect/"
        "ble/hci0"
        "/etc/rect/users"
      ]
      [
        cfg.robot
        "\"${cfg.fleet}/"
        "ble/${cfg.adapter}"
        cfg.loginFile
      ]
      (builtins.readFile shipped.file)
  );

  # A flag for each value, as to set a whole part would take its other values back to Zenoh's defaults.
  leaves =
    path: value:
    if lib.isAttrs value then
      lib.concatLists (lib.mapAttrsToList (key: leaves (path ++ [ key ])) value)
    else
      [ { inherit path value; } ];
  settings = leaves [ ] cfg.settings;
  isSecret =
    { path, ... }:
    builtins.match "password|.*private_key_(pem|base64)" (lib.last path) != null;

  connections = "/var/lib/rect/connections.json";
  private = {
    user = "rect";
    group = "rect";
  };

  # config/bluetooth.conf as hardware.bluetooth.settings, so that its values are in one place.
  bluetoothSettings =
    let
      read =
        { section, found }:
        line:
        let
          header = builtins.match "\\[(.+)]" line;
          pair = builtins.match "([A-Za-z]+) *= *(.+)" line;
        in
        {
          section = if header == null then section else lib.head header;
          found =
            found
            ++ lib.optional (pair != null) { ${section}.${lib.head pair} = mkDefault (lib.last pair); };
        };
      start = {
        section = "";
        found = [ ];
      };
      lines = lib.splitString "\n" (builtins.readFile ../../config/bluetooth.conf);
    in
    mkMerge (lib.foldl' read start lines).found;

  portsOf =
    protocols:
    lib.concatMap (
      endpoint:
      let
        port = builtins.match "(${protocols})/.*:([0-9]+)([?#].*)?" endpoint;
      in
      lib.optional (port != null) (lib.toInt (lib.elemAt port 1))
    ) cfg.listen;
in
{
  options.services.rect-router = {
    enable = mkEnableOption "RECT's router: robots that talk over Bluetooth Low Energy, TCP and UDP";

    package = mkOption {
      type = types.package;
      default = pkgs.callPackage ./package.nix { };
      defaultText = literalExpression "pkgs.callPackage ./package.nix { }";
      example = literalExpression "inputs.rect.packages.aarch64-linux.rect";
      description = "The programs, and the systemd unit in them.";
    };

    robot = mkOption {
      type = types.nullOr name;
      default = null;
      example = "wombat-1";
      description = "This robot's name: what others dial, and the second part of its keys. Unique in the hall.";
    };

    fleet = mkOption {
      type = name;
      default = "rect";
      example = "lions";
      description = "The team's name, the first part of all keys.";
    };

    adapter = mkOption {
      type = types.strMatching "hci[0-9]+|sim.*";
      default = "hci0";
      example = "hci1";
      description = "The Bluetooth adapter; one named `sim...` is of the simulated air.";
    };

    baseStation = mkOption {
      type = types.bool;
      default = false;
      example = true;
      description = "Whether this is the team's laptop, from which the robots' settings may be changed.";
    };

    loginFile = mkOption {
      type = secretPath;
      default = "/etc/rect/users";
      example = "/run/secrets/rect-users";
      description = ''
        The team's logins, `user:password` a line; the first line is the secret of Bluetooth too. Not in the Nix store,
        which everybody can read, and readable by group `rect`. Without it nobody gets in: the router does not start.

        `rect-router init wombat-1 --folder new` makes one, `new/users`, for all robots of the team. Once it is in its
        place: `systemctl start rect-router`.
      '';
    };

    loginAs = mkOption {
      type = types.nullOr types.str;
      default = if cfg.baseStation then "config" else "fleet";
      defaultText = literalExpression ''if baseStation then "config" else "fleet"'';
      example = "wombat-2";
      description = "As whom of the login file this router shows itself where it dials; `null`: as nobody.";
    };

    members = mkOption {
      type = types.listOf types.str;
      default = [ ];
      example = [ "alice" ];
      description = ''
        Users whose programs may log in: members of group `rect`, who can read the login file and reach the socket
        {file}`/run/rect/router.sock`. They know the team's secret.
      '';
    };

    listen = mkOption {
      type = types.listOf types.str;
      default = [ ];
      example = [ "tcp/0.0.0.0:7448" ];
      description = ''
        More listeners. Without any, the router listens to this computer's own programs and to Bluetooth. Who comes in by
        another one logs in, and then may what `access_control` says: in the shipped configuration, nothing.
      '';
    };

    openFirewall = mkOption {
      type = types.bool;
      default = false;
      example = true;
      description = "Whether to open the firewall for the ports in {option}`services.rect-router.listen`.";
    };

    configFile = mkOption {
      type = types.nullOr secretPath;
      default = null;
      example = "/etc/rect/robot.json5";
      description = ''
        A configuration that is kept by hand, such as `rect-router init` writes; not in the Nix store, as it may hold
        passwords. Robot, fleet, adapter and logins are its to say then. `null`: the shipped one, with those given here.
      '';
    };

    settings = mkOption {
      inherit (pkgs.formats.json { }) type;
      default = { };
      example = {
        connect.endpoints = [ "ble/wombat-2" ];
        plugins.rect.auto_connect = "fleet";
      };
      description = ''
        Zenoh's settings and, in `plugins.rect`, RECT's, in place of those in the configuration file. A list replaces the
        file's. They can be read by everybody: nothing secret here.
      '';
    };

    configureBluetooth = mkOption {
      type = types.bool;
      default = true;
      example = false;
      description = ''
        Whether to switch Bluetooth on, set as {file}`config/bluetooth.conf` says: Low Energy alone, and robots find each
        other in a fraction of a second. Each value gives way to yours in {option}`hardware.bluetooth.settings`.
      '';
    };
  };

  config = mkIf cfg.enable (mkMerge [
    {
      assertions = [
        {
          assertion = cfg.robot != null || cfg.configFile != null;
          message = "services.rect-router.robot: this robot has no name yet; give it one, or a configFile that has one.";
        }
        {
          assertion = !lib.any isSecret settings;
          message = "services.rect-router.settings: everybody could read this password or key; it is for loginFile or configFile.";
        }
      ];

      # What `init` writes into the file.
      services.rect-router.settings.plugins.rect = mkMerge [
        (mkIf (cfg.configFile == null) {
          robot = mkDefault cfg.robot;
          fleet = mkDefault cfg.fleet;
          connections = mkDefault connections;
          login_as = mkIf (cfg.loginAs != null) (mkDefault cfg.loginAs);
        })
        (mkIf (cfg.listen != [ ]) { inherit (cfg) listen; })
      ];

      systemd.packages = [ cfg.package ];
      systemd.services.rect-router = {
        # NixOS does not read a unit's [Install].
        wantedBy = [ "multi-user.target" ];
        # The empty ones take back the unit's own.
        unitConfig.ConditionPathExists = [
          ""
          (if cfg.configFile == null then cfg.loginFile else cfg.configFile)
        ];
        serviceConfig = {
          ExecStart = [
            ""
            (utils.escapeSystemdExecArgs (
              [
                (lib.getExe' cfg.package "rect-router")
                "-c"
                (if cfg.configFile == null then generated else cfg.configFile)
              ]
              ++ lib.concatMap (
                { path, value }:
                [
                  "--cfg"
                  "${lib.concatStringsSep "/" path}:${builtins.toJSON value}"
                ]
              ) settings
            ))
          ];
          # Debian's group: in NixOS BlueZ listens to everybody, and systemd starts nothing in a group that is not there.
          SupplementaryGroups = [ "" ];
        };
      };

      # The list of connections, where the router's configuration service may change it, and empty to begin with.
      systemd.tmpfiles.settings.rect-router = {
        "/var/lib/rect".d = private // {
          mode = "0750";
        };
        ${connections} = mkIf (cfg.configFile == null) {
          f = private // {
            mode = "0640";
            argument = builtins.toJSON { connections = [ ]; };
          };
        };
      };

      users.users.rect = {
        isSystemUser = true;
        group = "rect";
        description = "RECT's router";
      };
      users.groups.rect.members = cfg.members;

      environment.systemPackages = [ cfg.package ];
    }

    (mkIf cfg.openFirewall {
      networking.firewall.allowedTCPPorts = portsOf "tcp|tls|ws";
      networking.firewall.allowedUDPPorts = portsOf "udp|quic";
    })

    (mkIf cfg.configureBluetooth {
      hardware.bluetooth = {
        enable = true;
        settings = bluetoothSettings;
      };
    })
  ]);
}
