# RECT for Nix: packages, a shell to work on it, a module for NixOS. How it is built: packaging/nix/package.nix.
#
# This flake has never been built. The tests evaluate it with a stub of nixpkgs (tests/nix), which finds errors in these
# expressions, but not a missing or renamed part of nixpkgs, nor an error of the build.
#
#   nix build .#rect .#librect
#   nix develop                 # then cargo, cmake and ctest as everywhere; what `make` calls installs by apt, on Debian
#   nix flake check             # builds all, tries the library from CMake and pkg-config, and the service in a VM
{
  description = "RECT: robots communicate over TCP, UDP and Bluetooth Low Energy";

  # Any nixpkgs from 25.05 on: Rust 1.85.
  inputs.nixpkgs.url = "github:NixOS/nixpkgs/nixos-unstable";

  outputs =
    { self, nixpkgs }:
    let
      forEachSystem =
        outputs:
        nixpkgs.lib.genAttrs [
          "x86_64-linux"
          "aarch64-linux"
        ] (system: outputs nixpkgs.legacyPackages.${system});
    in
    {
      packages = forEachSystem (pkgs: rec {
        default = rect;
        rect = pkgs.callPackage ./packaging/nix/package.nix { };
        inherit (rect) librect;
      });

      overlays.default = final: _: {
        rect = final.callPackage ./packaging/nix/package.nix { };
        inherit (final.rect) librect;
      };

      nixosModules.default = ./packaging/nix/module.nix;

      devShells = forEachSystem (pkgs: {
        default = pkgs.mkShell {
          # nixpkgs' Rust, close to rust-toolchain.toml's, whose clippy is the one that counts.
          packages = with pkgs; [
            cargo
            clippy
            rustc
            rustfmt
            rust-analyzer
            # C and C++
            cmake
            ninja
            pkg-config
            doxygen
            catch2_3
            nlohmann_json
            # Python's package, demo and benches
            python3
            ruff
            # Bluetooth, and the VM that has it without hardware
            bluez
            qemu
            shellcheck
          ];
          # For rust-analyzer.
          RUST_SRC_PATH = pkgs.rustPlatform.rustLibSrc;
        };
      });

      checks = forEachSystem (
        pkgs:
        let
          inherit (self.packages.${pkgs.stdenv.hostPlatform.system}) rect librect;
        in
        {
          inherit rect librect;

          # Builds a separate project with find_package and with pkg-config, like rect-cpp/tests/installed.
          consumer = pkgs.stdenv.mkDerivation {
            name = "rect-consumer";
            src = ./rect-cpp/tests/consumer;
            nativeBuildInputs = [
              pkgs.cmake
              pkgs.pkg-config
            ];
            buildInputs = [ librect ];
            installPhase = ''
              $CXX -std=c++17 ../main.cpp $(pkg-config --cflags --libs rect) -o by_pkg_config
              for program in consumer consumer_static consumer_c by_pkg_config; do
                ./$program | tee -a $out
              done
              [ "$(sort -u $out)" = '${rect.version}: published' ]
            '';
          };

          # Without Bluetooth, which the VM has none of.
          service = pkgs.testers.runNixOSTest {
            name = "rect-router";
            nodes.machine = {
              imports = [ self.nixosModules.default ];
              services.rect-router = {
                enable = true;
                robot = "wombat-7";
                members = [ "alice" ];
                settings.listen.endpoints = [
                  "tcp/127.0.0.1:7447"
                  "unixsock-stream//run/rect/router.sock"
                ];
              };
              users.users.alice.isNormalUser = true;
            };
            testScript = ''
              machine.wait_for_unit("multi-user.target")
              # Nobody gets in before there is a login file.
              machine.fail("systemctl is-active rect-router")

              machine.succeed(
                  "rect-router init wombat-7 --folder /root/new",
                  "install -D -m 640 -g rect /root/new/users /etc/rect/users",
                  "systemctl start rect-router",
              )
              machine.wait_for_open_port(7447, "127.0.0.1")
              machine.wait_for_file("/run/rect/router.sock")
              machine.wait_until_succeeds("su alice -c 'rect-router status' | grep wombat-7")

              # The module's configuration is that of `init`, which ends with RECT's own settings.
              start = machine.succeed("systemctl show -P ExecStart rect-router").split()
              ours = machine.succeed("cat " + start[start.index("-c") + 1]).rstrip().removesuffix("}")
              theirs = machine.succeed("cat /root/new/robot.json5").replace("/root/new", "/etc/rect")
              assert theirs.startswith(ours), theirs

              machine.succeed("systemctl stop rect-router")
            '';
          };
        }
      );
    };
}
