// Teleoperation: steering commands overtake everything else, and a robot that hears none for half a second stops.
//
//     build/default/examples/teleoperation wombat-1             # is driven
//     build/default/examples/teleoperation laptop wombat-1      # drives it
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

void drive(const rect::Robot& robot, const char* other) {
    const auto urgent = rect::must(robot.with(rect::Urgency::urgent));
    for (int n = 0; n < 200; ++n) {
        const auto left = std::sin(n / 20.0);
        rect::must(urgent.send(other, "drive", rect::Cbor(Drive{left, -left})));
        std::this_thread::sleep_for(50ms);
    }
    rect::must(urgent.send(other, "drive", rect::Cbor(stop)));
}

void be_driven(const rect::Robot& robot) {
    const auto commands = rect::must(robot.subscribe("*/drive"));
    for (;;) {
        const auto message = commands.next(500ms);
        if (message) {
            const auto command = rect::must((*message)->payload.value<Drive>());
            std::cout << (*message)->from() << " says " << command.left << " " << command.right << std::endl;
        } else if (message.error().code == rect::Code::timed_out) {
            std::cout << "nobody steers: " << stop.left << " " << stop.right << std::endl;
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
        be_driven(robot);
    }
}
