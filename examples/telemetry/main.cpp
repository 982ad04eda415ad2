// Telemetry: a robot tells its arm's angle and its battery ten times a second, as small as can be, and hears others'.
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

Telemetry measured(int n) { return {std::round(std::sin(n / 20.0) * 900) / 10, 7.2, n % 100 < 50}; }

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));

    // Messages like those to come make a dictionary, with which 60 bytes become a third. Others fetch it by themselves.
    std::vector<std::string> samples;
    for (int n = 0; n < 2000; ++n) {
        samples.push_back(nlohmann::json(measured(n)).dump());
    }
    const auto packed = rect::must(robot.packed_with(rect::must(rect::Dictionary::train(samples, 4096))));

    const auto others = rect::must(robot.subscribe("*/telemetry", [](const rect::MessageView& message) {
        const auto telemetry = message.payload.value<Telemetry>();
        if (telemetry) {
            std::cout << message.from() << ": " << telemetry->angle_deg << " deg, " << telemetry->battery_volt << " V\n"
                      << std::flush;
        } else {
            std::cerr << message.from() << ": " << telemetry.error().text << "\n";
        }
    }));
    for (int n = 0;; ++n) {
        rect::must(packed.publish("telemetry", measured(n)));
        std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
}
