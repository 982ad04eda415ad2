// Telemetry: a robot publishes its arm's angle and battery voltage ten times per second, compressed with a dictionary, and
// prints those of other robots.
//
//     build/default/examples/telemetry wombat-1
#include <chrono>
#include <cmath>
#include <iostream>
#include <rect.hpp>
#include <rect/nlohmann.hpp>
#include <thread>

struct Telemetry {
    double angle_deg;
    double battery_volt;
    bool moving;
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Telemetry, angle_deg, battery_volt, moving)

Telemetry measure(int n) { return {std::round(std::sin(n / 20.0) * 900) / 10, 7.2, n % 100 < 50}; }

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));

    // Trains a dictionary on messages of the same kind, which reduces 60 bytes to a third. Receivers fetch it automatically.
    std::vector<std::string> samples;
    for (int n = 0; n < 2000; ++n) {
        samples.push_back(nlohmann::json(measure(n)).dump());
    }
    const auto compressing = rect::must(robot.with_dictionary(rect::must(rect::Dictionary::train(samples, 4096))));

    const auto subscription = rect::must(robot.subscribe("*/telemetry", [](const rect::MessageView& message) {
        const auto telemetry = message.payload.value<Telemetry>();
        if (telemetry) {
            std::cout << message.sender() << ": " << telemetry->angle_deg << " deg, " << telemetry->battery_volt << " V\n"
                      << std::flush;
        } else {
            std::cerr << message.sender() << ": " << telemetry.error().text << "\n";
        }
    }));
    for (int n = 0;; ++n) {
        rect::must(compressing.publish("telemetry", measure(n)));
        std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
}
