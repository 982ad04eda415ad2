/// @file
/// RECT for C++17 and later: robots that exchange messages, streams and files over TCP, UDP and Bluetooth Low Energy.
/// `rect/nlohmann.hpp` adds JSON and CBOR by nlohmann::json.
#ifndef RECT_HPP
#define RECT_HPP

#include "rect/robot.hpp"

#endif
