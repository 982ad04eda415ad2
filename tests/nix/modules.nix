# The part of nixpkgs' module system that RECT's module uses: options with types, `mkIf`, `mkMerge` and `mkDefault`. Values of
# options that no module declares, such as systemd's, are merged without a type.
let
  inherit (builtins)
    all
    any
    attrNames
    concatLists
    concatMap
    filter
    foldl'
    head
    isAttrs
    isList
    isString
    length
    map
    match
    throw
    ;

  normal = 100;
  isPlain = value: isAttrs value && !(value ? _type) && !(value ? outPath);

  # Returns the definitions in a value, with the conditions under which they count and their priorities.
  definitions =
    condition: priority: value:
    if value._type or null == "if" then
      definitions (condition && value.condition) priority value.content
    else if value._type or null == "merge" then
      concatMap (definitions condition priority) value.contents
    else if value._type or null == "override" then
      definitions condition value.priority value.content
    else
      [ { inherit condition priority value; } ];

  # Returns the definitions of a part of the configuration. The conditions are not evaluated, as they depend on other options.
  at = path: found: foldl' child found path;
  child =
    found: name:
    concatMap (
      { condition, priority, value }:
      if isPlain value && value ? ${name} then definitions condition priority value.${name} else [ ]
    ) found;

  # Returns the definitions that count: those of the best priority whose conditions are true.
  counting =
    found:
    let
      active = filter (definition: definition.condition) found;
      best = foldl' (best: definition: if definition.priority < best then definition.priority else best) 10000 active;
    in
    map (definition: definition.value) (filter (definition: definition.priority == best) active);

  mergeAny =
    place: found:
    let
      active = filter (definition: definition.condition) found;
      values = counting found;
      names = concatMap ({ value, ... }: attrNames value) active;
    in
    if active != [ ] && all ({ value, ... }: isPlain value) active then
      builtins.listToAttrs (
        concatMap (
          name:
          let
            below = child active name;
          in
          # A name whose definitions all depend on false conditions does not exist.
          if filter (definition: definition.condition) below == [ ] then
            [ ]
          else
            [
              {
                inherit name;
                value = mergeAny "${place}.${name}" below;
              }
            ]
        ) names
      )
    else if values != [ ] && all isList values then
      concatLists values
    else
      mergeOne place values;

  mergeOne =
    place: values:
    if values == [ ] then
      throw "${place} is used, but not defined"
    else if all (value: value == head values) values then
      head values
    else
      throw "${place} has several different values";

  type = name: check: {
    inherit name check;
    merge = place: found: mergeOne place (counting found);
  };
in
rec {
  mkIf = condition: content: {
    _type = "if";
    inherit condition content;
  };
  mkMerge = contents: {
    _type = "merge";
    inherit contents;
  };
  mkDefault = content: {
    _type = "override";
    priority = 1000;
    inherit content;
  };
  mkOption = option: option // { _type = "option"; };
  mkEnableOption =
    description:
    mkOption {
      type = types.bool;
      default = false;
      description = "Whether to enable ${description}.";
    };
  literalExpression = text: {
    _type = "literalExpression";
    inherit text;
  };

  types = {
    bool = type "a boolean" builtins.isBool;
    str = type "text" isString;
    strMatching = pattern: type "text matching ${pattern}" (value: isString value && match pattern value != null);
    package = type "a package" (value: value.type or null == "derivation");
    pathWith =
      { absolute, inStore }:
      type "a path" (
        value:
        isString value
        && (!absolute || match "/.*" value != null)
        && (inStore == (match "/nix/store/.*" value != null))
      );
    nullOr = of: type "null or ${of.name}" (value: value == null || of.check value);
    listOf =
      of:
      type "a list of ${of.name}" (value: isList value && all of.check value)
      // {
        merge =
          _: found:
          let
            values = counting found;
          in
          if all isList values then concatLists values else head values;
      };
    json = type "JSON" (value: builtins.isString (builtins.toJSON value)) // {
      merge = mergeAny;
    };
  };

  # Returns the configuration that modules define. `path` is where the first module declares its options.
  evalModules =
    {
      modules,
      path,
      arguments,
    }:
    let
      # A module is a file, a function or a configuration.
      evaluate =
        module:
        if builtins.isPath module then
          evaluate (import module)
        else if builtins.isFunction module then
          module (arguments // { inherit config; })
        else
          { config = module; };
      evaluated = map evaluate modules;
      found = concatMap (module: definitions true normal (module.config or { })) evaluated;
      declared = foldl' (set: name: set.${name}) (head evaluated).options path;
      value =
        name: option:
        let
          place = "${builtins.concatStringsSep "." path}.${name}";
          own = child (at path found) name;
          all = if option ? default then own ++ definitions true 1500 option.default else own;
          merged = option.type.merge place all;
        in
        if option.type.check merged then merged else throw "${place} is not ${option.type.name}";
      undeclared = filter (name: !(declared ? ${name})) (
        concatMap (definition: attrNames definition.value) (at path found)
      );
      own =
        if undeclared == [ ] then
          builtins.mapAttrs value declared
        else
          throw "there is no option ${builtins.concatStringsSep "." path}.${head undeclared}";
      # The other parts. Which of them exist must not depend on a condition, which may depend on the options.
      other =
        name:
        let
          defined = child found name;
        in
        if any (definition: definition.condition) defined then mergeAny name defined else { };
      others = builtins.listToAttrs (
        map (name: {
          inherit name;
          value = other name;
        }) (concatMap (definition: attrNames definition.value) found)
      );
      config = others // foldl' (set: name: { ${name} = set; }) own (reversed path);
      reversed = list: if list == [ ] then [ ] else reversed (builtins.tail list) ++ [ (head list) ];
    in
    config;
}
