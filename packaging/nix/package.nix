# Owns how Nix builds RECT: the programs, the plugin for a stock zenohd and, as its `librect`, the C and C++ library.
#
#   nix build .#rect .#librect
#   pkgs.callPackage ./packaging/nix/package.nix { }     # the same, without flakes
{
  lib,
  stdenv,
  rustPlatform,
  installShellFiles,
  cmake,
  ninja,
}:
let
  inherit (lib) fileset;

  # What cargo reads, and what is installed. Pages, scripts and results of benches change without a new build.
  forCargo = fileset.unions [
    ../../Cargo.toml
    ../../Cargo.lock
    (fileset.fileFilter (file: !file.hasExt "md") ../../config)
    ../systemd/rect-router.service
    ../../benches/codecs.rs
    ../../benches/rounds.rs
    (fileset.unions (
      # All members of the workspace: cargo wants each one's manifest, and the files of the targets that manifests name.
      map (fileset.fileFilter (file: file.hasExt "rs" || file.name == "Cargo.toml")) [
        ../../src
        ../../examples
        ../../tests
        ../../zenoh-link
        ../../zenoh-link-ble
        ../../zenoh-link-slot
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
  # The one place that says it.
  inherit ((lib.importTOML ../../Cargo.toml).workspace.package) version;

  src = fileset.toSource {
    root = ../..;
    fileset = forCargo;
  };
  # All dependencies are crates.io's. libdbus, zstd and libwebp are in their crates as C: a C compiler is all they take.
  cargoLock.lockFile = ../../Cargo.lock;

  # One command for all, as in scripts/build-plugins: a router takes a plugin of the same zenoh with the same features,
  # and zenoh is compiled once.
  cargoBuildFlags = lib.concatMap (name: [ "-p" name ]) [
    "rect"
    "rect-router"
    "rect-cpp"
    "zenoh-plugin-rect"
  ];

  # The tests start routers that talk over the network, and a VM for Bluetooth: `make test`, outside of the sandbox.
  doCheck = false;

  # `library` is what librect is made of. Not called `lib`, or the plugin would be moved there.
  outputs = [
    "out"
    "library"
  ];

  nativeBuildInputs = [ installShellFiles ];

  postInstall = ''
    mkdir -p $library/lib
    mv $out/lib/librect_cpp.{so,a} $library/lib/

    install -Dm644 -t $out/share/rect/config config/*.json* config/*.conf
    substituteInPlace packaging/systemd/rect-router.service --replace-fail /usr/bin/rect-router $out/bin/rect-router
    install -Dm644 -t $out/lib/systemd/system packaging/systemd/rect-router.service
  ''
  # Manual and completions come from the programs themselves, which do not run here if built for another processor.
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
      # Relative, as rect.pc puts them behind its own prefix; nixpkgs gives absolute ones (NixOS/nixpkgs#144170).
      (lib.cmakeFeature "CMAKE_INSTALL_LIBDIR" "lib")
      (lib.cmakeFeature "CMAKE_INSTALL_INCLUDEDIR" "include")
    ];

    meta = {
      description = "RECT for C and C++: headers, shared and static library, CMake package";
      inherit (finalAttrs.meta) license platforms;
    };
  };

  meta = {
    description = "Robots talk over TCP, UDP and Bluetooth Low Energy: a Zenoh router with a BLE link, and its tools";
    # Either, as Zenoh's.
    license = with lib.licenses; [
      epl20
      asl20
    ];
    platforms = lib.platforms.linux;
    mainProgram = "rect";
  };
})
