// Joins without a router, and says something to nobody.
#include <cstdio>
#include <rect.hpp>

int main() {
    rect::Options options;
    options.listen = {"tcp/127.0.0.1:0"};
    const auto robot = rect::connect("wombat-1", options);
    const auto said = robot ? robot->publish("greeting", "hello") : rect::unexpected<rect::Error>(robot.error());
    std::printf("%s: %s\n", rect::version(), said ? "said" : said.error().text.c_str());
    return said ? 0 : 1;
}
