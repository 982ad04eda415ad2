//! Nothing: the dependencies are what is wanted (`scripts/build-rest-plugin`).
