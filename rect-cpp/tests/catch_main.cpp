// Runs the tests or benchmarks of a program. Version 2 of Catch2 compiles its own code here.
#define CATCH_CONFIG_RUNNER
#include "catch.hpp"

int main(int argc, char* argv[]) { return Catch::Session().run(argc, argv); }
