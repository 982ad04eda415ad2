# The part of nixpkgs that RECT's expressions use, without any package. Derivations are attribute sets whose attributes have
# the types that Nix accepts; nothing is built. Names that are missing here fail the evaluation.
{ system }:
let
  inherit (builtins)
    all
    attrNames
    concatLists
    concatMap
    elem
    filter
    isAttrs
    isBool
    isInt
    isList
    isPath
    isString
    pathExists
    readDir
    throw
    ;

  fileset = rec {
    # A file set is the list of its files.
    files =
      set:
      if isList set then
        set
      else if !(pathExists set) then
        throw "${toString set} does not exist"
      else
        filesBelow (_: true) set;
    filesBelow =
      accepts: path:
      let
        entries = readDir path;
        below =
          name:
          if entries.${name} == "directory" then
            filesBelow accepts (path + "/${name}")
          else if accepts (file name) then
            [ (path + "/${name}") ]
          else
            [ ];
      in
      if isDirectory path then concatMap below (attrNames entries) else [ path ];
    isDirectory = path: (readDir (dirOf path)).${baseNameOf path} == "directory";
    file = name: {
      inherit name;
      hasExt = extension: lib.hasSuffix ".${extension}" name;
      type = "regular";
    };
    unions = concatMap files;
    fileFilter = accepts: path: filesBelow accepts path;
    toSource =
      { root, fileset }:
      {
        outPath = toString root;
        inherit root;
        files = files fileset;
      };
  };

  lib = rec {
    inherit fileset;
    inherit (builtins)
      any
      concatLists
      concatMap
      concatStringsSep
      filter
      elemAt
      foldl'
      head
      isAttrs
      replaceStrings
      ;
    importTOML = path: builtins.fromTOML (builtins.readFile path);
    genAttrs = names: make: builtins.listToAttrs (map (name: { inherit name; value = make name; }) names);
    mapAttrsToList = make: set: map (name: make name set.${name}) (attrNames set);
    last = list: elemAt list (builtins.length list - 1);
    optional = condition: value: if condition then [ value ] else [ ];
    optionalString = condition: text: if condition then text else "";
    hasSuffix =
      suffix: text:
      let
        length = builtins.stringLength suffix;
        start = builtins.stringLength text - length;
      in
      start >= 0 && builtins.substring start length text == suffix;
    splitString = separator: text: filter isString (builtins.split separator text);
    toInt = builtins.fromJSON;
    cmakeFeature = name: value: assert isString value; "-D${name}:STRING=${value}";
    cmakeBool = name: value: assert isBool value; "-D${name}:BOOL=${if value then "TRUE" else "FALSE"}";
    getExe' = package: name: "${package}/bin/${name}";
    licenses = {
      asl20 = "Apache-2.0";
      epl20 = "EPL-2.0";
    };
    platforms.linux = [
      "x86_64-linux"
      "aarch64-linux"
    ];
  }
  // modules;

  modules = import ./modules.nix;

  # Returns whether a value can be an attribute of a derivation.
  isDerivationValue =
    value:
    isString value
    || isPath value
    || isBool value
    || isInt value
    || value == null
    || (isList value && all isDerivationValue value)
    || (isAttrs value && value ? outPath);
  # Attributes that nixpkgs does not pass to Nix.
  forNixpkgs = [
    "cargoLock"
    "meta"
    "passthru"
  ];

  mkDerivation =
    given:
    let
      arguments = if builtins.isFunction given then given (arguments // { inherit finalPackage; }) else given;
      name = arguments.name or "${arguments.pname}-${arguments.version}";
      outputs = arguments.outputs or [ "out" ];
      invalid = filter (key: !(elem key forNixpkgs || isDerivationValue arguments.${key})) (attrNames arguments);
      output = output: {
        outPath =
          if invalid != [ ] then
            throw "${name}: ${toString invalid} cannot be an attribute of a derivation"
          else
            "/nix/store/${name}${if output == "out" then "" else "-${output}"}";
      };
      finalPackage =
        arguments
        // lib.genAttrs outputs output
        // arguments.passthru or { }
        // {
          inherit name;
          inherit (output "out") outPath;
          type = "derivation";
        };
    in
    finalPackage;

  package = name: mkDerivation { inherit name; };

  pkgs = rec {
    inherit lib;
    stdenv = {
      inherit mkDerivation;
      buildPlatform.canExecute = _: true;
      hostPlatform = {
        inherit system;
      };
    };
    rustPlatform = {
      buildRustPackage =
        given:
        mkDerivation (
          final:
          let
            arguments = given final;
          in
          assert pathExists arguments.cargoLock.lockFile;
          arguments
        );
      rustLibSrc = package "rust-lib-src";
    };
    mkShell = arguments: mkDerivation ({ name = "shell"; } // arguments);
    writeText = name: text: (package name) // { inherit text; };
    formats.json = _: { type = lib.types.json; };
    # NixOS is not evaluated: its test's machine is, as a module.
    testers.runNixOSTest = test: (package test.name) // { inherit test; };
    callPackage = path: arguments: (import path) (builtins.intersectAttrs (builtins.functionArgs (import path)) pkgs // arguments);
  }
  // lib.genAttrs [
    "bluez"
    "cargo"
    "clippy"
    "cmake"
    "doxygen"
    "catch2_3"
    "installShellFiles"
    "nasm"
    "ninja"
    "nlohmann_json"
    "pkg-config"
    "python3"
    "qemu"
    "ruff"
    "rust-analyzer"
    "rustc"
    "rustfmt"
    "shellcheck"
  ] package;
in
pkgs
