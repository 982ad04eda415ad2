// Connects programs to the two routers on the simulated air that run_with_routers.py starts.
#ifndef RECT_TESTS_ROUTERS_HPP
#define RECT_TESTS_ROUTERS_HPP

#include <cstdlib>
#include <stdexcept>

#include "pair.hpp"

inline rect::Robot connect_to(const char* name, const char* variable) {
    const char* endpoint = std::getenv(variable);
    if (endpoint == nullptr) {
        throw std::runtime_error(std::string(variable) + " is not set; run this test with run_with_routers.py");
    }
    rect::Options options;
    options.router = endpoint;
    return must(rect::connect(name, options));
}

// The robots `wombat-1` and `wombat-2`, each at its router.
struct Routers {
    rect::Robot one = connect_to("wombat-1", "RECT_ROUTER_1");
    rect::Robot two = connect_to("wombat-2", "RECT_ROUTER_2");
};

#endif
