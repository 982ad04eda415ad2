// Teleoperation: drive commands are urgent and overtake all other messages, and expire. A robot that receives none for
// half a second stops.
//
//     build/default/examples/teleoperation wombat-1             # receives commands
//     build/default/examples/teleoperation laptop wombat-1      # sends commands
#include <chrono>
#include <cmath>
#include <iostream>
#include <rect.hpp>
#include <rect/nlohmann.hpp>
#include <string_view>
#include <thread>

using namespace std::chrono_literals;

struct Drive {
    double left;
    double right;
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Drive, left, right)

constexpr Drive stop{0, 0};
// A drive command is dropped rather than executed later than this. The last one, to stop, never expires.
constexpr auto lifetime = 200ms;

void drive(const rect::Robot& robot, const char* recipient) {
    const auto urgent = rect::must(robot.with_urgency(rect::Urgency::urgent));
    const auto steering = rect::must(urgent.expires_after(lifetime));
    for (int n = 0; n < 200; ++n) {
        const auto left = std::sin(n / 20.0);
        const auto sent = steering.send(recipient, "drive", rect::Cbor(Drive{left, -left}));
        if (!sent && sent.error().code == rect::Code::not_reachable) {
            // It stops by itself, and is steered again when it is back.
            std::cerr << sent.error().text << std::endl;
        } else {
            rect::must(sent);
        }
        std::this_thread::sleep_for(50ms);
    }
    rect::must(urgent.send(recipient, "drive", rect::Cbor(stop)));
}

void follow(const rect::Robot& robot) {
    // The robot also stops before the first command, when the sender is unreachable, and while the fleet is stopped.
    const auto deadman = rect::must(robot.deadman<Drive>(
        "*/drive", 500ms,
        [](const Drive& command) { std::cout << "driving: " << command.left << " " << command.right << std::endl; },
        [](std::string_view reason) { std::cout << "stopping: " << reason << std::endl; }));
    while (!rect::must(robot.is_closed())) {
        std::this_thread::sleep_for(1s);
    }
}

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));
    if (argc > 2) {
        drive(robot, argv[2]);
    } else {
        follow(robot);
    }
}
