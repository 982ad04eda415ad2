/* Log: a robot logs lines, which `rect log` shows at any robot of the fleet, and raises an alert.
 *
 *     build/default/examples/log_c wombat-1
 */
#include <rect.h>

int main(int argc, char **argv) {
    rect_robot robot;
    const rect_log_line line = {
        .level = RECT_LEVEL_WARN, .text = "the gripper is slow", .fields = "{\"angle\": 12.5}", .file = __FILE__, .line = __LINE__};
    if (rect_connect(argc > 1 ? argv[1] : "wombat-1", NULL, &robot, NULL) != RECT_CODE_OK) {
        return 1;
    }
    rect_robot_log(robot, RECT_LEVEL_INFO, "ready");
    rect_robot_log_line(robot, &line);
    /* Until rect_robot_clear_alert. */
    rect_robot_alert(robot, RECT_LEVEL_WARN, "battery low", NULL);
    return rect_drop(&robot.id, NULL) == RECT_CODE_OK ? 0 : 1;
}
