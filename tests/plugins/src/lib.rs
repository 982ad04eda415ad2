//! Nothing: the dependencies are what is wanted (`scripts/build-plugins`).
