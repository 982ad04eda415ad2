//! Contains no code. The package exists for its dependencies, which `scripts/build-plugins` builds.
