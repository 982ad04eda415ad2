// Log: a robot logs lines, which `rect log` shows at any robot of the fleet, and raises an alert.
//
//     build/default/examples/log wombat-1
#include <rect.hpp>

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));
    robot.log(rect::Level::info, "ready");
    rect::LogLine line{rect::Level::warn, "the gripper is slow"};
    line.fields = R"({"angle": 12.5})";
    robot.log_line(line);
    // Until robot.clear_alert("battery low").
    rect::must(robot.alert(rect::Level::warn, "battery low"));
}
