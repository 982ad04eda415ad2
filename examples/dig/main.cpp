// Dig: a robot carries out a long task, which another one starts, follows and cancels.
//
//     build/default/examples/dig wombat-2                  # digs when it is asked to
//     build/default/examples/dig wombat-1 wombat-2 5       # asks wombat-2 to dig 5 cm deep, and prints how it goes
#include <chrono>
#include <iostream>
#include <rect/nlohmann.hpp>
#include <rect.hpp>
#include <string>

using namespace std::chrono_literals;

std::string dig(rect::Goal& goal) {
    const auto depth = rect::must(goal.payload.value<int>());
    for (int done = 0; done < depth; ++done) {
        rect::must(goal.feedback(std::to_string(done) + " cm", 1.0 * done / depth));
        // Throws if the goal is cancelled: then nothing more is dug.
        goal.sleep(500ms);
    }
    return "a hole of " + std::to_string(depth) + " cm";
}

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));
    if (argc < 4) {
        const auto action = rect::must(robot.action("dig", dig));
        std::cout << "ready to dig, until Enter" << std::endl;
        std::cin.get();
        return 0;
    }
    const auto run = rect::must(robot.start(argv[2], "dig", std::stoi(argv[3])));
    const auto feedback = rect::must(run.on_feedback([](const rect::FeedbackView& feedback) {
        std::cout << feedback.value.text().value_or("?") << ", " << 100 * feedback.progress.value_or(0) << " %" << std::endl;
    }));
    // The result, or the reason why there is none: the goal has failed, or was refused, cancelled or preempted.
    const auto result = run.result<std::string>(60s);
    if (!result) {
        rect::must(run.cancel());
        std::cout << result.error().text << std::endl;
        return 1;
    }
    std::cout << *result << std::endl;
}
