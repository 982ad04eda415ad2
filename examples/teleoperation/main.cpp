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
    const auto commands = rect::must(robot.subscribe("*/drive"));
    for (;;) {
        const auto message = commands.next(500ms);
        if (message) {
            const auto command = rect::must(message->payload.value<Drive>());
            std::cout << message->sender() << ": " << command.left << " " << command.right << std::endl;
        } else if (message.error().code == rect::Code::timed_out) {
            std::cout << "no commands, stopping: " << stop.left << " " << stop.right << std::endl;
        } else {
            return;
        }
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
