# Evaluates all of flake.nix with the stub of nixpkgs: packages, overlay, shell, checks, and the module with several settings.
# The result is what tests/nix/check compares: the files of each source, and the parts of the configurations.
let
  root = ../..;
  flake = import (root + "/flake.nix");
  systems = [
    "x86_64-linux"
    "aarch64-linux"
  ];
  stub = system: import ./nixpkgs.nix { inherit system; };
  inherit (stub "x86_64-linux") lib;

  self = flake.outputs {
    inherit self;
    nixpkgs = {
      inherit lib;
      legacyPackages = lib.genAttrs systems stub;
    };
  };

  overlaid = let before = stub "x86_64-linux"; in before // self.overlays.default overlaid before;

  # Forces a derivation, with all that it is built from.
  derivation = package: builtins.deepSeq (removeAttrs package [ "finalPackage" ]) package.outPath;
  relative = path: lib.replaceStrings [ (toString root + "/") ] [ "" ] (toString path);
  sources = package: map relative package.src.files;

  robot =
    settings:
    let
      configuration = lib.evalModules {
        path = [
          "services"
          "rect-router"
        ];
        modules = [
          self.nixosModules.default
          settings
        ];
        arguments = {
          inherit lib;
          pkgs = stub "x86_64-linux";
          utils.escapeSystemdExecArgs = lib.concatStringsSep " ";
        };
      };
      service = configuration.systemd.services.rect-router;
    in
    {
      failed = map (assertion: assertion.message) (lib.filter (assertion: !assertion.assertion) configuration.assertions);
      start = lib.last service.serviceConfig.ExecStart;
      dashboard =
        if configuration.systemd.services ? rect-dashboard then
          lib.last configuration.systemd.services.rect-dashboard.serviceConfig.ExecStart
        else
          null;
      conditions = service.unitConfig.ConditionPathExists;
      bluetooth = configuration.hardware.bluetooth.settings or null;
      firewall = configuration.networking.firewall.allowedTCPPorts or null;
      members = configuration.users.groups.rect.members;
      files = builtins.attrNames configuration.systemd.tmpfiles.settings.rect-router;
      packages = map derivation (configuration.systemd.packages ++ configuration.environment.systemPackages);
    };
  enabled = settings: robot { services.rect-router = { enable = true; } // settings; };
  ofVM = self.checks.x86_64-linux.service.test.nodes.machine;
in
{
  packages = lib.genAttrs systems (
    system: builtins.mapAttrs (_: derivation) self.packages.${system} // { shell = derivation self.devShells.${system}.default; }
  );
  overlay = map derivation [
    overlaid.rect
    overlaid.librect
  ];
  consumer = map derivation (with self.checks.x86_64-linux; [
    consumer
    rect
    librect
  ]);
  sources = {
    rect = sources self.packages.x86_64-linux.rect;
    librect = sources self.packages.x86_64-linux.librect;
  };
  robots = {
    named = enabled {
      robot = "wombat-7";
      members = [ "alice" ];
    };
    nameless = enabled { };
    base_station = enabled {
      robot = "laptop";
      baseStation = true;
      listen = [ "tcp/0.0.0.0:7448" ];
      openFirewall = true;
      configureBluetooth = false;
      dashboard = [
        "--listen"
        "0.0.0.0:8080"
      ];
    };
    own_file = enabled { configFile = "/etc/rect/robot.json5"; };
    with_secret = enabled {
      robot = "wombat-7";
      settings.transport.auth.usrpwd.password = "secret";
    };
    of_the_vm = robot (removeAttrs ofVM [ "imports" ]);
  };
  # Each of these is an error.
  rejected = map (settings: (builtins.tryEval (builtins.deepSeq (enabled settings) true)).success) [
    { robot = "a/b"; }
    {
      robot = "a";
      loginFile = "/nix/store/users";
    }
    {
      robot = "a";
      members = "alice";
    }
    {
      robot = "a";
      robots = 2;
    }
  ];
}
