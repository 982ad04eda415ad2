// State: a robot retains its mode. A program that starts later receives the last mode of each robot first, and then each change.
//
//     build/default/examples/state wombat-1 auto      # retains the mode, and ends
//     build/default/examples/state wombat-2           # prints the modes of all robots
//     build/default/examples/state wombat-1 none      # forgets the mode
#include <chrono>
#include <iostream>
#include <rect.hpp>
#include <string>

void print(const rect::MessageView& message) {
    const auto retained = message.retained().value_or(rect::Retained{});
    // A topic that was forgotten has no value.
    const auto mode = retained.is_forgotten ? "none" : message.payload.text().value_or("?");
    const auto age = std::chrono::duration_cast<std::chrono::seconds>(retained.age);
    std::cout << message.sender() << ": " << mode << ", for " << age.count() << " s" << std::endl;
}

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));
    if (argc > 2 && argv[2] == std::string("none")) {
        rect::must(robot.forget("mode"));
        return 0;
    }
    if (argc > 2) {
        // The router of this robot keeps the value when this program ends.
        rect::must(rect::must(robot.retained()).publish("mode", argv[2]));
        return 0;
    }
    const auto modes = rect::must(robot.subscribe("*/mode"));
    // Until Ctrl-C.
    while (const auto message = modes.next()) {
        print(*message);
    }
}
