// Stands for <kipr/wombat.h> where there is no Wombat: the calls of libwallaby that the example uses, which say what they
// would do. Its motors do not turn.
#ifndef WOMBAT_STUB_HPP
#define WOMBAT_STUB_HPP

#include <iostream>

// Turns a motor with -100 to 100 percent of its power.
inline void motor(int port, int percent) { std::cout << "motor " << port << ": " << percent << " %" << std::endl; }

// All motors off.
inline void ao() { std::cout << "motors off" << std::endl; }

// An analog sensor, 0 to 4095.
inline int analog(int port) { return 1000 + port; }

// The battery, 0 to 1.
inline double power_level() { return 0.8; }

// Whether the button is pressed.
inline int side_button() { return 0; }

#endif
