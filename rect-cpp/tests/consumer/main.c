/* Connects without a router and publishes a message, in C. */
#include <rect.h>
#include <stdio.h>

int main(void) {
    const char *listen[] = {"tcp/127.0.0.1:0"};
    rect_options options = {0};
    options.listen = listen;
    options.listen_len = 1;
    rect_robot robot;
    rect_error error;
    const rect_payload hello = rect_payload_text("hello");
    if (rect_connect("wombat-1", &options, &robot, &error) != RECT_CODE_OK ||
        rect_robot_publish(robot, "greeting", &hello, &error) != RECT_CODE_OK) {
        printf("%s\n", error.text);
        return 1;
    }
    printf("%s: published\n", rect_version());
    return rect_drop(&robot.id, NULL) == RECT_CODE_OK ? 0 : 1;
}
