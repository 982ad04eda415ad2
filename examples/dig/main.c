/* Dig: a robot carries out a long task, which another one starts, follows and cancels.
 *
 *     build/default/examples/dig_c wombat-2                  (digs when it is asked to)
 *     build/default/examples/dig_c wombat-1 wombat-2 5       (asks wombat-2 to dig 5 cm deep, and prints how it goes)
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

static void on_dig(const rect_goal *goal, void *context) {
    char text[40];
    rect_payload payload;
    int done;
    int depth;
    (void)context;
    snprintf(text, sizeof text, "%.*s", (int)goal->payload.len, (const char *)goal->payload.data);
    depth = atoi(text);
    for (done = 0; done < depth; ++done) {
        snprintf(text, sizeof text, "%d cm", done);
        payload = rect_payload_text(text);
        rect_goal_feedback(goal->id, &payload, 1.0 * done / depth, NULL);
        /* Fails if the goal is cancelled: then nothing more is dug. */
        if (rect_goal_sleep(goal->id, 500, NULL) != RECT_CODE_OK) {
            return;
        }
    }
    snprintf(text, sizeof text, "a hole of %d cm", depth);
    payload = rect_payload_text(text);
    rect_goal_done(goal->id, &payload, NULL);
}

static void on_feedback(const rect_feedback *feedback, void *context) {
    (void)context;
    printf("%.*s, %.0f %%\n", (int)feedback->value.len, (const char *)feedback->value.data, 100 * feedback->progress);
    fflush(stdout);
}

int main(int argc, char **argv) {
    rect_robot robot;
    check(rect_connect(argc > 1 ? argv[1] : "wombat-1", NULL, &robot, &error));
    if (argc < 4) {
        rect_action action;
        check(rect_robot_action(robot, "dig", NULL, on_dig, NULL, NULL, &action, &error));
        printf("ready to dig, until Enter\n");
        fflush(stdout);
        getchar();
        rect_drop(&action.id, NULL);
    } else {
        const rect_payload depth = rect_payload_json(argv[3]);
        rect_action_run run;
        rect_subscription feedback;
        rect_buffer result;
        check(rect_robot_start(robot, argv[2], "dig", &depth, NULL, 10000, &run, &error));
        check(rect_action_run_on_feedback(run, on_feedback, NULL, NULL, &feedback, &error));
        /* The result, or the reason why there is none: the goal has failed, or was refused, cancelled or preempted. */
        check(rect_action_run_result(run, 60000, &result, &error));
        printf("%.*s\n", (int)result.payload.len, (const char *)result.payload.data);
        rect_drop(&result.id, NULL);
        rect_drop(&feedback.id, NULL);
        rect_drop(&run.id, NULL);
    }
    return rect_drop(&robot.id, NULL) == RECT_CODE_OK ? 0 : 1;
}
