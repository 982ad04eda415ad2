/* State: a robot retains its mode. A program that starts later receives the last mode of each robot first, and then each change.
 *
 *     build/default/examples/state_c wombat-1 auto      (retains the mode, and ends)
 *     build/default/examples/state_c wombat-2           (prints the modes of all robots)
 *     build/default/examples/state_c wombat-1 none      (forgets the mode)
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

static void set_mode(rect_robot robot, const char *mode) {
    rect_robot retaining;
    const rect_payload payload = rect_payload_text(mode);
    if (strcmp(mode, "none") == 0) {
        check(rect_robot_forget(robot, "mode", &error));
        return;
    }
    /* The router of this robot keeps the value when this program ends. */
    check(rect_robot_retained(robot, &retaining, &error));
    check(rect_robot_publish(retaining, "mode", &payload, &error));
    rect_drop(&retaining.id, NULL);
}

int main(int argc, char **argv) {
    rect_robot robot;
    rect_subscriber modes;
    rect_message message;
    check(rect_connect(argc > 1 ? argv[1] : "wombat-1", NULL, &robot, &error));
    if (argc > 2) {
        set_mode(robot, argv[2]);
        rect_drop(&robot.id, NULL);
        return 0;
    }
    check(rect_robot_subscribe(robot, "*/mode", NULL, &modes, &error));
    /* Until Ctrl-C. */
    for (;;) {
        check(rect_subscriber_next(modes, RECT_FOREVER, &message, &error));
        printf("%.*s: ", (int)message.sender.len, (const char *)message.sender.data);
        if (message.is_forgotten) {
            /* The message has no value. */
            printf("none, for 0 s\n");
        } else {
            printf("%.*s, for %d s\n", (int)message.payload.len, (const char *)message.payload.data,
                   message.retained ? (int)message.age_s : 0);
        }
        fflush(stdout);
        rect_drop(&message.id, NULL);
    }
}
