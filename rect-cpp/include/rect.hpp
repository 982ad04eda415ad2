/// @file
/// RECT for C++17 and later: robots exchange messages, streams and files over TCP, UDP and Bluetooth Low Energy.
///
/// Start with rect::connect, which returns a rect::Robot. `rect/nlohmann.hpp` adds JSON and CBOR with nlohmann::json.
#ifndef RECT_HPP
#define RECT_HPP

#include "rect/robot.hpp"

#endif
