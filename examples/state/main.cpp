// State: a robot retains its mode. A program that starts later receives the last mode of each robot first, and then each change.
//
//     build/default/examples/state wombat-1 auto      # retains the mode, and ends
//     build/default/examples/state wombat-2           # prints the modes of all robots
//     build/default/examples/state wombat-1 none      # forgets the mode
#include <iostream>
#include <rect.hpp>
#include <string>

void set_mode(const rect::Robot& robot, const std::string& mode) {
    if (mode == "none") {
        rect::must(robot.forget("mode"));
        return;
    }
    const auto previous = rect::must(robot.latest(rect::must(robot.name()), "mode"));
    std::cout << "mode: " << (previous ? previous->payload.text().value_or("?") : "none") << " -> " << mode << std::endl;
    // The router of this robot keeps the value when this program ends.
    rect::must(rect::must(robot.retained()).publish("mode", mode));
}

void print(const rect::MessageView& message) {
    std::cout << message.sender() << ": ";
    const auto retained = message.retained();
    if (retained && retained->is_forgotten) {
        std::cout << "no mode" << std::endl;
    } else {
        std::cout << message.payload.text().value_or("?") << ", for " << (retained ? retained->age.count() : 0) << " s" << std::endl;
    }
}

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));
    if (argc > 2) {
        set_mode(robot, argv[2]);
        return 0;
    }
    const auto modes = rect::must(robot.subscribe("*/mode"));
    // Until Ctrl-C.
    while (const auto message = modes.next()) {
        print(*message);
    }
}
