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
#include <thread>

#include "wombat_stub.hpp"

using namespace std::chrono_literals;
using nlohmann::json;

constexpr int left_port = 0;
constexpr int right_port = 3;
constexpr int light_port = 1;

// Converts a speed from -1 to 1 to percent.
int percent(double speed) { return static_cast<int>(std::clamp(speed, -1.0, 1.0) * 100); }

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));
    const auto light = rect::must(robot.stream("light", rect::StreamOptions::sensor()));
    const auto commands = rect::must(robot.subscribe("*/drive", {1, rect::WhenFull::drop_oldest}));
    const auto battery = rect::must(robot.serve("battery", [](const rect::Request&) { return json(power_level()); }));

    auto last_command = std::chrono::steady_clock::now();
    while (!side_button()) {
        const auto message = commands.next(50ms);
        const auto drive = message ? message->payload.value<json>() : rect::unexpected<rect::Error>(message.error());
        if (drive && drive->is_object()) {
            last_command = std::chrono::steady_clock::now();
            motor(left_port, percent(drive->value("left", 0.0)));
            motor(right_port, percent(drive->value("right", 0.0)));
        } else if (std::chrono::steady_clock::now() - last_command > 500ms) {
            // No commands: stop.
            ao();
        }
        rect::must(light.send(json(analog(light_port))));
    }
    ao();
}
