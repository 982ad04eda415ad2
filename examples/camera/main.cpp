// Camera: sends pictures as a stream. Their size and quality adapt to the link: large over Wi-Fi, small over Bluetooth.
//
//     build/default/examples/camera wombat-1              # sends pictures
//     build/default/examples/camera laptop wombat-1       # receives them
#include <chrono>
#include <cmath>
#include <cstdint>
#include <iostream>
#include <rect.hpp>
#include <string>
#include <thread>
#include <vector>

constexpr int width = 320;
constexpr int height = 240;

// Returns the pixels of a simulated camera: a bright ball that circles in front of a grey wall.
std::vector<std::uint8_t> take_picture(int n) {
    const double x = 160 + 80 * std::cos(n / 10.0);
    const double y = 120 + 80 * std::sin(n / 10.0);
    std::vector<std::uint8_t> pixels;
    pixels.reserve(width * height * 3);
    for (int row = 0; row < height; ++row) {
        for (int column = 0; column < width; ++column) {
            const bool is_ball = std::hypot(column - x, row - y) < 20;
            const auto wall = static_cast<std::uint8_t>(90 + row / 4);
            if (is_ball) {
                pixels.insert(pixels.end(), {250, 200, 30});
            } else {
                pixels.insert(pixels.end(), {90, 90, wall});
            }
        }
    }
    return pixels;
}

void watch(const rect::Robot& robot, const char* other) {
    const auto camera = rect::must(robot.watch(std::string(other) + "/camera"));
    while (const auto frame = camera.next()) {
        const auto picture = rect::must(frame->payload.picture());
        const auto age = frame->age().value_or(std::chrono::microseconds(0));
        std::cout << "frame " << frame->number() << ": " << picture.width() << "x" << picture.height() << ", "
                  << age.count() / 1000 << " ms old, " << frame->skipped() << " frames skipped" << std::endl;
    }
}

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));
    if (argc > 2) {
        watch(robot, argv[2]);
        return 0;
    }
    const auto camera = rect::must(robot.stream("camera"));
    for (int n = 0;; ++n) {
        const auto pixels = take_picture(n);
        rect::must(camera.send(rect::Picture(width, height, rect::Format::rgb8, pixels)));
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
}
