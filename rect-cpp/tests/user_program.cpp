// A program of a user. The compiler accepts it without its wrong lines, and rejects each of those (test_advice.py).
#include <iostream>
#include <rect.hpp>
#include <rect/nlohmann.hpp>

struct Battery {
    double percent;
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Battery, percent)

struct Pose {
    double x;
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Pose, x)

struct NoAdapter {};

int main() {
    const auto robot = rect::must(rect::connect("wombat-1"));
    const auto publisher = rect::must(robot.publisher<Battery>("battery"));
    rect::must(publisher.publish(Battery{80}));
    rect::must(publisher.publish(Pose{1}));  // wrong
    const auto batteries = rect::must(robot.subscribe<Battery>("*/battery"));
    while (const auto message = batteries.next()) {
        std::cout << message->sender() << rect::must(message->value()).percent;
        std::cout << rect::must(message->value()).volts;  // wrong
        Pose pose = rect::must(message->value());  // wrong
    }
    const auto any = rect::must(robot.subscribe("*/battery"));
    std::cout << rect::must(any.next()).value();  // wrong
    const auto none = rect::must(robot.subscribe<NoAdapter>("*/x")).next();  // wrong
    const auto subscription = robot.subscribe<Battery>("*/battery", [](const rect::MessageOf<Battery>&) {});
    const auto wrong = robot.subscribe<Battery>("*/battery", [](const rect::MessageOf<Pose>&) {});  // wrong
    std::cout << rect::must(robot.request<Pose>("wombat-2", "pose", "")).value.x;
    const int number = rect::must(robot.request<Pose>("wombat-2", "pose", "")).value;  // wrong
}
