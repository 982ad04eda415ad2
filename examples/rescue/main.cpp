// Rescue: each robot publishes its battery and serves its pose. If the battery of one is low, the others ask it.
//
//     build/default/examples/rescue wombat-1
//     build/default/examples/rescue wombat-2 12      # its battery has 12 percent
#include <chrono>
#include <iostream>
#include <rect.hpp>
#include <rect/nlohmann.hpp>
#include <string>

struct Battery {
    double percent = 0;
    bool charging = false;
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE_WITH_DEFAULT(Battery, percent, charging)

struct Pose {
    double x;
    double y;
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Pose, x, y)

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));
    const auto service = rect::must(robot.serve("pose", [](const rect::Request&) { return Pose{1.5, 0.5}; }));
    const auto publisher = rect::must(robot.publisher<Battery>("battery"));
    const auto batteries = rect::must(robot.subscribe<Battery>("*/battery"));
    rect::must(publisher.wait_for_subscriber(std::chrono::seconds(60)));
    rect::must(publisher.publish({argc > 2 ? std::stod(argv[2]) : 80, false}));
    while (const auto message = batteries.next()) {
        const auto& battery = message->value();
        if (!battery) {
            std::cout << message->sender() << ": " << message->problem() << std::endl;
        } else if (battery->percent < 20 && !battery->charging) {
            const auto pose = rect::must(robot.request<Pose>(std::string(message->sender()), "pose", "")).value;
            std::cout << message->sender() << " needs help at " << pose.x << ", " << pose.y << std::endl;
        } else {
            std::cout << message->sender() << ": " << battery->percent << " percent" << std::endl;
        }
    }
}
