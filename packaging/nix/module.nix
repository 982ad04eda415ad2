# Defines RECT's router as a service of NixOS: `services.rect-router`. The unit with its privileges is the one in
# packaging/systemd; this module only adds the parts that differ on NixOS.
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

  # The same restriction as in the router: longer names do not fit into a Bluetooth advertisement.
  name = types.strMatching "[A-Za-z0-9._-]{1,29}";

  # A path outside the Nix store, which every user can read. A Nix path is rejected, too, as it would be copied to the store.
  secretPath = types.pathWith {
    absolute = true;
    inStore = false;
  };

  # Creates the same configuration as `rect-router init` from the shipped file. Text is replaced, because Nix cannot parse JSON5,
  # and because the program does not run when the system is cross-compiled.
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

  # One flag for each value: setting a whole object would reset its other values to Zenoh's defaults.
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

  # Converts config/bluetooth.conf to hardware.bluetooth.settings, so that the values are defined only once.
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
    enable = mkEnableOption "RECT's router for the communication of robots over Bluetooth Low Energy, TCP and UDP";

    package = mkOption {
      type = types.package;
      default = pkgs.callPackage ./package.nix { };
      defaultText = literalExpression "pkgs.callPackage ./package.nix { }";
      example = literalExpression "inputs.rect.packages.aarch64-linux.rect";
      description = "The package with the programs and the systemd unit.";
    };

    robot = mkOption {
      type = types.nullOr name;
      default = null;
      example = "wombat-1";
      description = "Name of this robot, by which other robots dial it; the second part of its keys. It must be unique among all robots in range.";
    };

    fleet = mkOption {
      type = name;
      default = "rect";
      example = "lions";
      description = "Name of the fleet, the first part of all keys.";
    };

    adapter = mkOption {
      type = types.strMatching "hci[0-9]+|sim.*";
      default = "hci0";
      example = "hci1";
      description = "The Bluetooth adapter. An adapter named `sim...` belongs to the simulated air.";
    };

    baseStation = mkOption {
      type = types.bool;
      default = false;
      example = true;
      description = "Whether this is a base station, from which the robots' connections may be changed.";
    };

    loginFile = mkOption {
      type = secretPath;
      default = "/etc/rect/users";
      example = "/run/secrets/rect-users";
      description = ''
        The team's login file, with one `user:password` per line; the first line is also the secret for Bluetooth. It must be
        readable by the group `rect`, and must not be in the Nix store, which every user can read. Without it the router does
        not start.

        `rect-router init wombat-1 --folder new` creates such a file, `new/users`, for all robots of the team. After copying
        it to this path, run `systemctl start rect-router`.
      '';
    };

    loginAs = mkOption {
      type = types.nullOr types.str;
      default = if cfg.baseStation then "config" else "fleet";
      defaultText = literalExpression ''if baseStation then "config" else "fleet"'';
      example = "wombat-2";
      description = "User of the login file as which this router logs in when it dials; `null` for no login.";
    };

    members = mkOption {
      type = types.listOf types.str;
      default = [ ];
      example = [ "alice" ];
      description = ''
        Users whose programs may log in. They become members of the group `rect`, which can read the login file, and thereby
        the team's secret, and can use the socket {file}`/run/rect/router.sock`.
      '';
    };

    listen = mkOption {
      type = types.listOf types.str;
      default = [ ];
      example = [ "tcp/0.0.0.0:7448" ];
      description = ''
        Additional listeners. By default the router listens for local programs and on Bluetooth. Clients of an additional
        listener have to log in, and need a policy in `access_control`: the shipped configuration grants them no access.
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
        Path of a configuration that you maintain yourself, such as one written by `rect-router init`. It must not be in the Nix
        store, because it may contain passwords. It then defines robot, fleet, adapter and logins. `null` selects the shipped
        configuration with the options given here.
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
        Settings of Zenoh and, in `plugins.rect`, of RECT, which override those of the configuration file. A list replaces the
        list of the file. Every user can read them, so they must not contain secrets.
      '';
    };

    dashboard = mkOption {
      type = types.nullOr (types.listOf types.str);
      default = null;
      example = [
        "--listen"
        "0.0.0.0:8080"
        "--record"
        "/var/lib/rect/recordings"
      ];
      description = ''
        Options of `rect dashboard`, which then runs as a service and serves a page that shows the robots. With the empty list,
        only this computer can open the page, at port 8080. `null` for no page.
      '';
    };

    configureBluetooth = mkOption {
      type = types.bool;
      default = true;
      example = false;
      description = ''
        Whether to enable Bluetooth with the settings of {file}`config/bluetooth.conf`: Low Energy only, and discovery in a
        fraction of a second. Your values in {option}`hardware.bluetooth.settings` take precedence.
      '';
    };
  };

  config = mkIf cfg.enable (mkMerge [
    {
      assertions = [
        {
          assertion = cfg.robot != null || cfg.configFile != null;
          message = "services.rect-router.robot: this robot has no name; set this option, or give a configFile that contains a name.";
        }
        {
          assertion = !lib.any isSecret settings;
          message = "services.rect-router.settings: every user could read this password or key; put it into loginFile or configFile.";
        }
      ];

      # The settings that `init` writes to the file.
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
        # NixOS ignores the [Install] section of units.
        wantedBy = [ "multi-user.target" ];
        # Empty values reset those of the unit.
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
          # The group bluetooth exists on Debian only. On NixOS, BlueZ accepts all users, and systemd does not start a service
          # with an unknown group.
          SupplementaryGroups = [ "" ];
        };
      };

      systemd.services.rect-dashboard = mkIf (cfg.dashboard != null) {
        wantedBy = [ "multi-user.target" ];
        serviceConfig.ExecStart = [
          ""
          (utils.escapeSystemdExecArgs (
            [
              (lib.getExe' cfg.package "rect")
              "dashboard"
            ]
            ++ cfg.dashboard
          ))
        ];
      };

      # The connections file, initially empty, in a folder where the config service can change it.
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
