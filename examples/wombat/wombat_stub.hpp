// Replaces <kipr/wombat.h> on computers other than a Wombat. The functions of libwallaby that the example uses print the
// command or return a fixed value.
#ifndef WOMBAT_STUB_HPP
#define WOMBAT_STUB_HPP

#include <iostream>

// Runs a motor at -100 to 100 percent of its power.
inline void motor(int port, int percent) { std::cout << "motor " << port << ": " << percent << " %" << std::endl; }

// Switches off all motors.
inline void ao() { std::cout << "motors off" << std::endl; }

// Returns the value of an analog sensor, 0 to 4095.
inline int analog(int port) { return 1000 + port; }

// Returns the charge of the battery, 0 to 1.
inline double power_level() { return 0.8; }

// Returns whether the button is pressed.
inline int side_button() { return 0; }

#endif
