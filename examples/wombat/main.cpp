// Wombat: a robot with two wheels and a light sensor. Other robots drive it with commands that expire (the example
// teleoperation), so an old command never moves it. It streams the values of its sensor.
// On a Wombat (the robot controller of KIPR), include <kipr/wombat.h> instead of the stub.
//
//     build/default/examples/wombat wombat-1
#include <algorithm>
#include <chrono>
#include <iostream>
#include <rect.hpp>
#include <rect/nlohmann.hpp>
#include <string_view>
#include <thread>

#include "wombat_stub.hpp"

using namespace std::chrono_literals;
using nlohmann::json;

constexpr int left_port = 0;
constexpr int right_port = 3;
constexpr int light_port = 1;

struct Drive {
    double left;
    double right;
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Drive, left, right)

// Converts a speed from -1 to 1 to percent.
int percent(double speed) { return static_cast<int>(std::clamp(speed, -1.0, 1.0) * 100); }

void follow(const Drive& drive) {
    motor(left_port, percent(drive.left));
    motor(right_port, percent(drive.right));
}

void stop(std::string_view reason) {
    ao();
    std::cout << "stopped: " << reason << std::endl;
}

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));
    const auto light = rect::must(robot.stream("light", rect::StreamOptions::sensor()));
    const auto battery = rect::must(robot.serve("battery", [](const rect::Request&) { return json(power_level()); }));
    // Stops the motors when no command arrives for half a second, when the sender is unreachable, while the fleet is stopped,
    // and at the end.
    const auto deadman = rect::must(robot.deadman<Drive>("*/drive", 500ms, follow, stop));
    while (!side_button()) {
        rect::must(light.send(json(analog(light_port))));
        std::this_thread::sleep_for(50ms);
    }
}
