// Wombat: a robot with two wheels and a light sensor is driven by others, and tells what it sees. On a Wombat include
// <kipr/wombat.h> instead of the stub.
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

int percent(double share) { return static_cast<int>(std::clamp(share, -1.0, 1.0) * 100); }

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));
    const auto light = rect::must(robot.stream("light", rect::StreamOptions::sensor()));
    const auto commands = rect::must(robot.subscribe("*/drive", {1, rect::WhenFull::newest_wins}));
    const auto battery = rect::must(robot.serve("battery", [](const rect::Request&) { return json(power_level()); }));

    auto heard = std::chrono::steady_clock::now();
    while (!side_button()) {
        const auto message = commands.next(50ms);
        const auto drive = message ? (*message)->payload.value<json>() : rect::unexpected<rect::Error>(message.error());
        if (drive && drive->is_object()) {
            heard = std::chrono::steady_clock::now();
            motor(left_port, percent(drive->value("left", 0.0)));
            motor(right_port, percent(drive->value("right", 0.0)));
        } else if (std::chrono::steady_clock::now() - heard > 500ms) {
            // Nobody steers.
            ao();
        }
        rect::must(light.send(json(analog(light_port))));
    }
    ao();
}
