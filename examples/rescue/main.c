/* Rescue: each robot publishes its battery and serves its pose. If the battery of one is low, the others ask it.
 * C has no types of values: the program writes and reads the JSON.
 *
 *     build/default/examples/rescue_c wombat-1
 *     build/default/examples/rescue_c wombat-2 12      (its battery has 12 percent)
 */
#include <rect.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static rect_error error;

/* Ends the program with the text of the error, which says what to do. */
static void check(rect_code code) {
    if (code != RECT_CODE_OK) {
        fprintf(stderr, "%s\n", error.text);
        exit(EXIT_FAILURE);
    }
}

static void answer(const rect_request *request, void *context) {
    const rect_payload pose = rect_payload_json("{\"x\": 1.5, \"y\": 0.5}");
    (void)context;
    rect_request_reply(request->id, &pose, NULL);
}

/* Finds the number after `"name":`. */
static int number(const rect_payload *payload, const char *name, double *value) {
    char text[200], key[40];
    const char *found;
    snprintf(text, sizeof text, "%.*s", (int)payload->len, (const char *)payload->data);
    snprintf(key, sizeof key, "\"%s\":", name);
    found = strstr(text, key);
    return found && sscanf(found + strlen(key), "%lf", value) == 1;
}

int main(int argc, char **argv) {
    rect_robot robot;
    rect_service service;
    rect_publisher publisher;
    rect_subscriber batteries;
    rect_message message;
    char text[60];
    snprintf(text, sizeof text, "{\"percent\": %s}", argc > 2 ? argv[2] : "80");
    const rect_payload own = rect_payload_json(text);
    const rect_payload nothing = rect_payload_text("");

    check(rect_connect(argc > 1 ? argv[1] : "wombat-1", NULL, &robot, &error));
    check(rect_robot_serve(robot, "pose", NULL, answer, NULL, NULL, &service, &error));
    check(rect_robot_publisher(robot, "battery", &publisher, &error));
    check(rect_robot_subscribe(robot, "*/battery", NULL, &batteries, &error));
    check(rect_publisher_wait_for_subscriber(publisher, 60000, &error));
    check(rect_publisher_publish(publisher, &own, &error));
    for (;;) {
        double percent, x, y;
        char sender[RECT_NAME_BYTES];
        check(rect_subscriber_next(batteries, RECT_FOREVER, &message, &error));
        snprintf(sender, sizeof sender, "%.*s", (int)message.sender.len, (const char *)message.sender.data);
        if (!number(&message.payload, "percent", &percent)) {
            printf("%s: no percent in its battery\n", sender);
        } else if (percent < 20) {
            rect_reply reply;
            check(rect_robot_request(robot, sender, "pose", &nothing, 10000, &reply, &error));
            if (number(&reply.payload, "x", &x) && number(&reply.payload, "y", &y)) {
                printf("%s needs help at %g, %g\n", sender, x, y);
            }
            rect_drop(&reply.id, NULL);
        } else {
            printf("%s: %g percent\n", sender, percent);
        }
        fflush(stdout);
        rect_drop(&message.id, NULL);
    }
}
