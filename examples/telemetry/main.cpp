// Telemetry: publishes an arm's angle and the battery's voltage ten times per second, and prints those of all robots.
//
//     build/default/examples/telemetry wombat-1
//     build/default/examples/telemetry wombat-1 compressed      # the messages after the first 100 have half the size
#include <chrono>
#include <cmath>
#include <iostream>
#include <limits>
#include <rect.hpp>
#include <rect/nlohmann.hpp>
#include <string>
#include <thread>
#include <vector>

struct Telemetry {
    double angle_deg;
    double battery_volt;
    bool moving;
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Telemetry, angle_deg, battery_volt, moving)

constexpr int first = 100;
constexpr int forever = std::numeric_limits<int>::max();

Telemetry measure(int n) { return {std::round(std::sin(n / 20.0) * 900) / 10, 7.2, n % 100 < 50}; }

void publish(const rect::Robot& robot, int begin, int end) {
    for (int n = begin; n < end; ++n) {
        rect::must(robot.publish("telemetry", measure(n)));
        std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
}

// Optional second step: trains a dictionary on the first 100 messages. Receivers fetch it automatically.
void publish_compressed(const rect::Robot& robot) {
    publish(robot, 0, first);
    std::vector<std::string> samples;
    for (int n = 0; n < first; ++n) {
        samples.push_back(nlohmann::json(measure(n)).dump());
    }
    const auto dictionary = rect::must(rect::Dictionary::train(samples, 1024));
    publish(rect::must(robot.with_dictionary(dictionary)), first, forever);
}

void print(const rect::MessageView& message) {
    const auto telemetry = message.payload.value<Telemetry>();
    if (telemetry) {
        std::cout << message.sender() << ": " << telemetry->angle_deg << " deg, " << telemetry->battery_volt << " V" << std::endl;
    } else {
        std::cerr << message.sender() << ": " << telemetry.error().text << std::endl;
    }
}

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));
    const auto subscription = rect::must(robot.subscribe("*/telemetry", print));
    if (argc > 2 && std::string(argv[2]) == "compressed") {
        publish_compressed(robot);
    } else {
        publish(robot, 0, forever);
    }
}
