/* Hello: publishes a message, sends a request, and prints what another robot publishes. Start `rect sim` first.
 *
 *     build/default/examples/hello_c
 */
#include <rect.h>
#include <stdio.h>
#include <stdlib.h>

static rect_error error;

/* Ends the program with the text of the error, which says what to do. */
static void check(rect_code code) {
    if (code != RECT_CODE_OK) {
        fprintf(stderr, "%s\n", error.text);
        exit(EXIT_FAILURE);
    }
}

int main(void) {
    rect_robot robot;
    rect_reply battery;
    rect_subscriber subscriber;
    rect_message message;
    const rect_payload hello = rect_payload_text("hello");
    const rect_payload nothing = rect_payload_text("");

    check(rect_connect("wombat-1", NULL, &robot, &error));
    /* Every program that subscribes to greetings receives this. */
    check(rect_robot_publish(robot, "greeting", &hello, &error));
    /* Only this program receives the reply. */
    check(rect_robot_request(robot, "wombat-2", "battery", &nothing, 2000, &battery, &error));
    printf("battery of %.*s: %.*s\n", (int)battery.sender.len, (const char *)battery.sender.data,
           (int)battery.payload.len, (const char *)battery.payload.data);
    fflush(stdout);
    rect_drop(&battery.id, NULL);
    /* Until Ctrl-C. */
    check(rect_robot_subscribe(robot, "wombat-2/**", NULL, &subscriber, &error));
    for (;;) {
        check(rect_subscriber_next(subscriber, 60000, &message, &error));
        printf("%.*s %.*s: %.*s\n", (int)message.sender.len, (const char *)message.sender.data, (int)message.topic.len,
               (const char *)message.topic.data, (int)message.payload.len, (const char *)message.payload.data);
        fflush(stdout);
        rect_drop(&message.id, NULL);
    }
}
