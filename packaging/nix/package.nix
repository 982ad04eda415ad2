# Builds RECT with Nix: the programs, the plugin for a stock zenohd and, as `librect`, the C and C++ library.
#
#   nix build .#rect .#librect
#   pkgs.callPackage ./packaging/nix/package.nix { }     # the same, without flakes
#
# It has never been built: see flake.nix.
{
  lib,
  stdenv,
  rustPlatform,
  installShellFiles,
  nasm,
  cmake,
  ninja,
}:
let
  inherit (lib) fileset;

  # The files that cargo reads and that are installed. Changes of other files, such as documentation, need no new build.
  forCargo = fileset.unions [
    ../../Cargo.toml
    ../../Cargo.lock
    (fileset.fileFilter (file: !file.hasExt "md") ../../config)
    ../systemd/rect-dashboard.service
    ../systemd/rect-router.service
    # The pages of the dashboard and of a survey are parts of the program.
    ../../crates/rect-dashboard/page
    ../../crates/rect-cli/src/survey/page
    ../../surveys/simulated-air.json
    # Examples of the crates: cargo requires the files of the targets in the manifests.
    ../../benches/codecs.rs
    ../../benches/message_cost.rs
    ../../benches/processor_time.rs
    ../../benches/record_cost.rs
    ../../benches/rounds.rs
    ../../benches/video_cost.rs
    ../../crates/rect/examples
    (fileset.unions (
      # All members of the workspace: cargo requires the manifest of each, and the files of the targets in the manifests.
      map (fileset.fileFilter (file: file.hasExt "rs" || file.name == "Cargo.toml")) [
        ../../crates
        ../../examples
        ../../tests
        ../../zenoh-link-ble
        ../../rect-router
        ../../rect-cpp
        ../../rect-py
      ]
    ))
  ];

  forCMake = fileset.unions [
    ../../rect-cpp/CMakeLists.txt
    ../../rect-cpp/cmake
    ../../rect-cpp/include
  ];
in
rustPlatform.buildRustPackage (finalAttrs: {
  pname = "rect";
  # The version is defined in Cargo.toml only.
  inherit ((lib.importTOML ../../Cargo.toml).workspace.package) version;

  src = fileset.toSource {
    root = ../..;
    fileset = forCargo;
  };
  # All dependencies are on crates.io. libdbus, zstd, libwebp and OpenH264 are C and C++ code in their crates, and need only a
  # compiler.
  cargoLock.lockFile = ../../Cargo.lock;

  # One command for all, as in scripts/build-plugins: a router loads only plugins with the same features of zenoh, and zenoh is
  # compiled only once.
  cargoBuildFlags = lib.concatMap (name: [ "-p" name ]) [
    "rect-cli"
    "rect-router"
    "rect-cpp"
    "zenoh-plugin-rect"
  ];

  # The tests use the network, and a VM for Bluetooth, so they do not run in the sandbox: `make test`.
  doCheck = false;

  # librect is built from `library`. With the name `lib`, the plugin would be moved there.
  outputs = [
    "out"
    "library"
  ];

  # nasm: OpenH264's code for SIMD.
  nativeBuildInputs = [
    installShellFiles
    nasm
  ];

  postInstall = ''
    mkdir -p $library/lib
    mv $out/lib/librect_cpp.{so,a} $library/lib/

    install -Dm644 -t $out/share/rect/config config/*.json* config/*.conf
    substituteInPlace packaging/systemd/rect-router.service --replace-fail /usr/bin/rect-router $out/bin/rect-router
    substituteInPlace packaging/systemd/rect-dashboard.service --replace-fail /usr/bin/rect $out/bin/rect
    install -Dm644 -t $out/lib/systemd/system packaging/systemd/rect-{dashboard,router}.service
  ''
  # The programs print their manual pages and completions, which is not possible when cross-compiling.
  + lib.optionalString (stdenv.buildPlatform.canExecute stdenv.hostPlatform) ''
    mkdir man
    for program in rect rect-router; do
      $out/bin/$program man man
      installShellCompletion --cmd $program \
        --bash <($out/bin/$program completion bash) \
        --zsh <($out/bin/$program completion zsh) \
        --fish <($out/bin/$program completion fish)
    done
    installManPage man/*
  '';

  passthru.librect = stdenv.mkDerivation {
    pname = "librect";
    inherit (finalAttrs) version;

    src = fileset.toSource {
      root = ../../rect-cpp;
      fileset = forCMake;
    };

    nativeBuildInputs = [
      cmake
      ninja
    ];
    cmakeFlags = [
      (lib.cmakeFeature "RECT_LIBRARY_DIR" "${finalAttrs.finalPackage.library}/lib")
      (lib.cmakeBool "RECT_BUILD_TESTS" false)
      (lib.cmakeBool "RECT_BUILD_EXAMPLES" false)
      # Relative paths, because rect.pc prepends its prefix; nixpkgs passes absolute ones (NixOS/nixpkgs#144170).
      (lib.cmakeFeature "CMAKE_INSTALL_LIBDIR" "lib")
      (lib.cmakeFeature "CMAKE_INSTALL_INCLUDEDIR" "include")
    ];

    meta = {
      description = "RECT for C and C++: headers, shared and static library, CMake package";
      inherit (finalAttrs.meta) license platforms;
    };
  };

  meta = {
    description = "Communication of robots over TCP, UDP and Bluetooth Low Energy: a Zenoh router with a BLE link, and tools";
    # Either licence may be chosen, as for Zenoh.
    license = with lib.licenses; [
      epl20
      asl20
    ];
    platforms = lib.platforms.linux;
    mainProgram = "rect";
  };
})
