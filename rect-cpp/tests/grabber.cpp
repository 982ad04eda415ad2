// A program of a user that serves `grab` and `scan`, for `rect-py/tests/test_killed.py`, which kills it. It appends the value of each
// request to a file before it works on it.
//
//     grabber ROUTER FILE PULSES PULSE_MS
//
// `scan` replies with `PULSES` numbers, one after each pulse of that duration; `grab` with its value after one pulse. The program ends
// with its standard input.
#include <chrono>
#include <fstream>
#include <iostream>
#include <limits>
#include <rect.hpp>
#include <string>
#include <thread>

int main(int argc, char** argv) {
    if (argc != 5) {
        std::cerr << "usage: grabber ROUTER FILE PULSES PULSE_MS" << std::endl;
        return 2;
    }
    const std::string file = argv[2];
    const auto pulses = std::stoi(argv[3]);
    const std::chrono::milliseconds pulse(std::stoi(argv[4]));
    rect::Options options;
    options.router = argv[1];
    options.program = "arm";
    const auto robot = rect::must(rect::connect("wombat-1", options));
    const auto append = [&](const rect::Request& request) {
        const std::string value(rect::must(request.payload.text()));
        std::ofstream(file, std::ios::app) << value + "\n" << std::flush;
        return value;
    };
    const auto grab = rect::must(robot.serve("grab", [&](const rect::Request& request) {
        const auto value = append(request);
        std::this_thread::sleep_for(pulse);
        return value;
    }));
    const auto scan = rect::must(robot.serve("scan", [&](const rect::Request& request) {
        append(request);
        for (int n = 1; n < pulses; ++n) {
            std::this_thread::sleep_for(pulse);
            rect::must(request.reply(std::to_string(n)));
        }
        std::this_thread::sleep_for(pulse);
        return std::to_string(pulses);
    }));
    std::cout << "serving" << std::endl;
    std::cin.ignore(std::numeric_limits<std::streamsize>::max(), EOF);
}
