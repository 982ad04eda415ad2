// Connects without a router and publishes a message, which has no subscribers, in C++.
#include <cstdio>
#include <rect.hpp>

int main() {
    rect::Options options;
    options.listen = {"tcp/127.0.0.1:0"};
    const auto robot = rect::connect("wombat-1", options);
    const auto published = robot ? robot->publish("greeting", "hello") : rect::unexpected<rect::Error>(robot.error());
    std::printf("%s: %s\n", rect::version(), published ? "published" : published.error().text.c_str());
    return published ? 0 : 1;
}
