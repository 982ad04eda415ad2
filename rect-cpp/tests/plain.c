/* Tests the C interface in C99: messages, retained ones, services, streams, transfers, parameters, the dead man's switch, the stop, logs,
 * alerts and actions. At the end, no handle remains.
 *
 *     ctest --preset default -R c99
 */
#include <rect.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The first port to listen on, the number of ports to try, and timeouts in milliseconds. */
enum { PORT = 27447, PORTS = 200, TIMEOUT_MS = 60000, RETRY_MS = 50 };

static rect_error error;

static void must(rect_code code, const char *what) {
    if (code != RECT_CODE_OK) {
        fprintf(stderr, "%s: %s (%d)\n", what, error.text, (int)code);
        exit(1);
    }
}

static void check(bool holds, const char *what) {
    if (!holds) {
        fprintf(stderr, "check failed: %s\n", what);
        exit(1);
    }
}

static bool equals(rect_text text, const char *expected) {
    return text.len == strlen(expected) && memcmp(text.data, expected, text.len) == 0;
}

static bool begins(rect_text text, const char *expected) {
    return text.len >= strlen(expected) && memcmp(text.data, expected, strlen(expected)) == 0;
}

static bool has_text(rect_payload payload, const char *expected) {
    rect_text text;
    must(rect_payload_as_text(&payload, &text, &error), "rect_payload_as_text");
    return equals(text, expected);
}

/* Connects programs of two robots, which are linked directly. */
static void connect_pair(rect_robot *one, rect_robot *two) {
    char endpoint[40];
    const char *endpoints[] = {endpoint};
    rect_options options = {0};
    int port;
    options.login_file = "/none";
    options.listen = endpoints;
    options.listen_len = 1;
    for (port = PORT;; ++port) {
        snprintf(endpoint, sizeof endpoint, "tcp/127.0.0.1:%d", port);
        rect_code code = rect_connect("wombat-1", &options, one, &error);
        if (code == RECT_CODE_OK) {
            break;
        }
        check(code == RECT_CODE_OPTION && port < PORT + PORTS, "a port is free");
    }
    options.listen_len = 0;
    options.endpoints = endpoints;
    options.endpoints_len = 1;
    must(rect_connect("wombat-2", &options, two, &error), "wombat-2");
}

static void on_message(const rect_message *message, void *context) {
    rect_robot *two = context;
    check(equals(message->sender, "wombat-1"), "the sender is wombat-1");
    must(rect_robot_publish(*two, "echo", &message->payload, NULL), "rect_robot_publish in a callback");
}

static void on_request(const rect_request *request, void *context) {
    const rect_payload volt = rect_payload_json("{\"volt\":3.6}");
    (void)context;
    must(rect_request_reply(request->id, &volt, &error), "rect_request_reply");
    must(rect_request_refuse(request->id, &volt, &error), "rect_request_refuse after a reply");
    check(rect_request_reply(request->id, &volt, NULL) == RECT_CODE_ARGUMENT, "a reply after a refusal is rejected");
}

static void on_progress(const rect_progress *progress, void *context) { *(uint64_t *)context = progress->received_bytes; }

static void messages(rect_robot one, rect_robot two) {
    rect_subscription echoing;
    rect_subscriber subscriber;
    rect_message message;
    rect_robot urgent;
    rect_code code;
    rect_counts_by_sender counts;
    rect_publisher greetings;
    bool has_subscribers;
    char name[RECT_NAME_BYTES];
    const rect_payload hello = rect_payload_text("hello");
    must(rect_robot_on_message(two, "wombat-1/greeting", NULL, on_message, &two, NULL, &echoing, &error), "on_message");
    must(rect_robot_subscribe(one, "wombat-2/echo", NULL, &subscriber, &error), "subscribe");
    must(rect_robot_with_urgency(one, RECT_URGENCY_URGENT, &urgent, &error), "with_urgency");
    must(rect_robot_wait_for_peer(one, "wombat-2", TIMEOUT_MS, &error), "wait_for_peer");
    must(rect_robot_wait_until_established(one, TIMEOUT_MS, &error), "wait_until_established");
    must(rect_robot_publisher(urgent, "greeting", &greetings, &error), "publisher");
    must(rect_publisher_wait_for_subscriber(greetings, TIMEOUT_MS, &error), "wait_for_subscriber");
    must(rect_publisher_has_subscribers(greetings, &has_subscribers, &error), "has_subscribers");
    check(has_subscribers, "there is a subscriber after waiting for one");
    do {
        must(rect_publisher_publish(greetings, &hello, &error), "publish");
        code = rect_subscriber_next(subscriber, RETRY_MS, &message, &error);
    } while (code == RECT_CODE_TIMED_OUT);
    must(code, "next");
    must(rect_drop(&greetings.id, &error), "drop");
    check(equals(message.sender, "wombat-2") && equals(message.topic, "echo") && has_text(message.payload, "hello"),
          "the echo is received");
    must(rect_drop(&message.id, &error), "drop");
    check(message.id == 0, "dropping sets the id to 0");
    must(rect_robot_name(urgent, &name, &error), "name");
    check(strcmp(name, "wombat-1") == 0, "the handle has the name of the robot");
    must(rect_robot_fleet(urgent, &name, &error), "fleet");
    check(strcmp(name, "rect") == 0, "the handle has the name of the fleet");
    must(rect_subscriber_counts_by_sender(subscriber, &counts, &error), "counts_by_sender");
    check(counts.len == 1 && equals(counts.items[0].sender, "wombat-2") && counts.items[0].received > 0, "a message is counted");
    must(rect_drop(&counts.id, &error), "drop");
    must(rect_drop(&urgent.id, &error), "drop");
    must(rect_drop(&subscriber.id, &error), "drop");
    must(rect_drop(&echoing.id, &error), "drop");
}

/* The last value of a retained topic is received by a program that subscribes later, until the topic is forgotten. */
static void retained(rect_robot one, rect_robot two) {
    rect_robot modes;
    rect_subscriber subscriber;
    rect_message message;
    static char large[65537];
    const rect_payload automatic = rect_payload_text("auto");
    const rect_payload too_large = rect_payload_bytes(large, sizeof large);
    must(rect_robot_latest(two, "wombat-1", "mode", TIMEOUT_MS, &message, &error), "latest");
    check(message.id == 0 && message.topic.len == 0, "there is no value");
    must(rect_drop(&message.id, &error), "drop");
    must(rect_robot_retained(one, &modes, &error), "retained");
    must(rect_robot_publish(modes, "mode", &automatic, &error), "publish");
    must(rect_robot_subscribe(two, "wombat-1/mode", NULL, &subscriber, &error), "subscribe");
    must(rect_subscriber_next(subscriber, TIMEOUT_MS, &message, &error), "next");
    check(has_text(message.payload, "auto") && message.retained && message.age_s >= 0, "the last value is received");
    check(!message.has_ended && !message.is_forgotten, "the value is current");
    must(rect_drop(&message.id, &error), "drop");
    must(rect_robot_latest(two, "wombat-1", "mode", TIMEOUT_MS, &message, &error), "latest");
    check(message.id != 0 && has_text(message.payload, "auto") && message.retained, "there is a value");
    must(rect_drop(&message.id, &error), "drop");
    check(rect_robot_publish(modes, "map", &too_large, &error) == RECT_CODE_NOT_RETAINED, "a large value is not kept");
    must(rect_robot_forget(one, "mode", &error), "forget");
    must(rect_subscriber_next(subscriber, TIMEOUT_MS, &message, &error), "next");
    check(message.retained && message.is_forgotten && message.payload.len == 0, "the topic is forgotten");
    must(rect_drop(&message.id, &error), "drop");
    must(rect_drop(&subscriber.id, &error), "drop");
    must(rect_drop(&modes.id, &error), "drop");
}

/* The causes are those of the last error, if it has any. */
static void causes(void) {
    const char *listen[] = {"carrier-pigeon/roof"};
    rect_options options = {0};
    rect_robot robot;
    char cause[RECT_ERROR_BYTES];
    options.login_file = "/none";
    options.listen = listen;
    options.listen_len = 1;
    check(rect_connect("wombat-1", &options, &robot, &error) == RECT_CODE_OPTION, "the endpoint is rejected");
    check(rect_error_cause(0, &cause) == RECT_CODE_OK && strstr(cause, "carrier-pigeon") != NULL, "the cause is Zenoh's error");
    check(rect_error_cause(0, NULL) == RECT_CODE_ARGUMENT, "NULL is rejected");
    check(rect_connect(NULL, NULL, &robot, &error) == RECT_CODE_ARGUMENT, "the name is required");
    check(rect_error_cause(0, &cause) == RECT_CODE_END, "an error of the caller has no cause");
}

static void services(rect_robot one, rect_robot two) {
    rect_service service;
    rect_reply reply;
    rect_code code;
    const rect_payload query = rect_payload_json("{\"cell\":1}");
    must(rect_robot_serve(two, "battery", NULL, on_request, NULL, NULL, &service, &error), "serve");
    do {
        code = rect_robot_request(one, "wombat-2", "battery", &query, TIMEOUT_MS, &reply, &error);
    } while (code == RECT_CODE_NO_SERVICE);
    must(code, "request");
    check(equals(reply.sender, "wombat-2") && has_text(reply.payload, "{\"volt\":3.6}"), "the reply is correct");
    must(rect_drop(&reply.id, &error), "drop");
    must(rect_drop(&service.id, &error), "drop");
}

static void streams(rect_robot one, rect_robot two) {
    rect_stream_sender stream;
    rect_stream_options options = {0};
    rect_watcher watch;
    rect_frame frame;
    rect_code code;
    int64_t round_trip_us;
    const unsigned char value[] = {12, 34};
    const rect_payload payload = rect_payload_bytes(value, sizeof value);
    options.mode = RECT_STREAM_MODE_SENSOR;
    must(rect_robot_stream(one, "distance", &options, &stream, &error), "stream");
    must(rect_robot_watch(two, "wombat-1/distance", NULL, &watch, &error), "watch");
    do {
        must(rect_stream_sender_send(stream, &payload, NULL, &error), "send");
        code = rect_watcher_next(watch, RETRY_MS, &frame, &error);
    } while (code == RECT_CODE_TIMED_OUT);
    must(code, "next");
    check(frame.payload.len == 2 && memcmp(frame.payload.data, value, 2) == 0, "the frame is correct");
    must(rect_watcher_round_trip(watch, &round_trip_us, &error), "round_trip");
    check(round_trip_us >= -1, "the round trip is not measured yet, or positive");
    must(rect_drop(&frame.id, &error), "drop");
    must(rect_drop(&watch.id, &error), "drop");
    must(rect_drop(&stream.id, &error), "drop");
}

static void transfers(rect_robot one, rect_robot two) {
    rect_receive_options receive_options = {0};
    rect_transfer_options options = {0};
    rect_transfer transfer;
    rect_transfers transfers;
    rect_received received;
    uint64_t received_bytes = 0;
    receive_options.max_bytes = 1000;
    options.payload = rect_payload_text("a map");
    options.timeout_ms = TIMEOUT_MS;
    must(rect_robot_receive_transfers(two, "*/map", &receive_options, &transfers, &error), "receive_transfers");
    must(rect_robot_begin_transfer(one, "wombat-2", "map", &options, on_progress, &received_bytes, NULL, &transfer, &error),
         "begin_transfer");
    must(rect_transfer_wait(transfer, TIMEOUT_MS, &error), "wait");
    check(rect_transfer_wait(transfer, TIMEOUT_MS, &error) == RECT_CODE_END, "the result is returned once");
    must(rect_drop(&transfer.id, &error), "drop");
    must(rect_transfers_next(transfers, TIMEOUT_MS, &received, &error), "next");
    check(received_bytes == 5 && received.size_bytes == 5 && has_text(received.payload, "a map"), "the transfer is complete");
    must(rect_drop(&received.id, &error), "drop");
    must(rect_drop(&transfers.id, &error), "drop");
}

static bool on_check(const rect_parameter_values *values, char (*reason)[RECT_ERROR_BYTES], void *context) {
    const double kp = rect_parameter_find(values, "kp")->number;
    (void)context;
    check(rect_parameter_find(values, "ki") == NULL, "there is no such parameter");
    snprintf(*reason, sizeof *reason, "kp cannot be %g", kp);
    return kp != 3;
}

static void on_change(const rect_parameter_change *change, void *context) {
    check(change->values.len == 5 && change->changed_len > 0, "something has changed");
    ++*(int *)context;
}

static void on_release(void *context) { *(int *)context += 100; }

static void parameters(rect_robot one, rect_robot two) {
    rect_parameters declared;
    rect_parameter_options options = {0};
    rect_parameter_group group;
    rect_parameter_values values;
    rect_string side;
    double number;
    int64_t steps;
    bool turbo;
    int changes = 0;
    const char *choices[] = {"left", "right"};
    const char *names[] = {"kp"};
    const double points[] = {1, 2};
    const rect_parameter_value order[] = {rect_parameter_number("kp", 2), rect_parameter_text("side", "right"),
                                          rect_parameter_bool("turbo", true), rect_parameter_integer("steps", 4),
                                          rect_parameter_numbers("points", points, 1)};
    const rect_parameter_value large = rect_parameter_number("kp", 11);
    const rect_parameter_value refused = rect_parameter_number("kp", 3);
    options.without_file = true;
    must(rect_parameters_new("drive", &declared, &error), "parameters_new");
    must(rect_parameters_add_number(declared, "kp", 1, 0, 10, "1/s", "gain", &error), "add_number");
    must(rect_parameters_add_choice(declared, "side", "left", choices, 2, NULL, &error), "add_choice");
    must(rect_parameters_add_bool(declared, "turbo", false, NULL, &error), "add_bool");
    must(rect_parameters_add_integer(declared, "steps", 3, 0, 8, NULL, NULL, &error), "add_integer");
    must(rect_parameters_add_numbers(declared, "points", points, 2, 0, 8, NULL, NULL, &error), "add_numbers");
    check(rect_parameters_make_read_only(declared, "ki", &error) == RECT_CODE_ARGUMENT, "there is no such parameter");
    must(rect_robot_parameters(two, declared, &options, on_check, on_change, &changes, on_release, &group, &error), "parameters");
    must(rect_drop(&declared.id, &error), "drop");
    must(rect_robot_wait_until_established(two, TIMEOUT_MS, &error), "wait_until_established");
    must(rect_robot_set_parameters(one, "wombat-2", "drive", order, 5, false, TIMEOUT_MS, &values, &error), "set_parameters");
    check(values.len == 5 && rect_parameter_find(&values, "kp")->number == 2, "the values are in force");
    must(rect_drop(&values.id, &error), "drop");
    must(rect_parameter_group_number(group, "kp", &number, &error), "number");
    must(rect_parameter_group_integer(group, "steps", &steps, &error), "integer");
    must(rect_parameter_group_bool(group, "turbo", &turbo, &error), "bool");
    must(rect_parameter_group_text(group, "side", &side, &error), "text");
    check(number == 2 && steps == 4 && turbo && equals(side.text, "right"), "the values are read");
    must(rect_drop(&side.id, &error), "drop");
    check(rect_parameter_group_number(group, "side", &number, &error) == RECT_CODE_ARGUMENT, "the type is another one");
    check(rect_parameter_group_number(group, "ki", &number, &error) == RECT_CODE_PARAMETERS, "there is no such parameter");
    check(rect_robot_set_parameters(one, "wombat-2", "drive", &large, 1, false, TIMEOUT_MS, NULL, &error) == RECT_CODE_SERVICE,
          "the value is too large");
    check(rect_parameter_group_set(group, &refused, 1, &error) == RECT_CODE_PARAMETERS && strcmp(error.text, "kp cannot be 3") == 0,
          "the check refuses the value");
    check(rect_robot_set_parameters(one, "wombat-2", "arm", order, 1, false, TIMEOUT_MS, NULL, &error) == RECT_CODE_NO_PARAMETERS,
          "there is no such group");
    check(rect_robot_set_parameters(one, "wombat-2", "drive", order, 1, true, TIMEOUT_MS, NULL, &error) == RECT_CODE_NOT_STORED,
          "there is no file");
    must(rect_robot_reset_parameters(one, "wombat-2", "drive", names, 1, false, TIMEOUT_MS, NULL, &error), "reset_parameters");
    must(rect_parameter_group_reset(group, NULL, 0, &error), "reset");
    must(rect_parameter_group_values(group, &values, &error), "values");
    check(values.len == 5 && values.items[0].number == 1 && values.items[4].numbers_len == 2, "the values are the defaults");
    must(rect_drop(&values.id, &error), "drop");
    must(rect_drop(&group.id, &error), "drop");
    check(changes == 103, "three changes were reported, and the context was released");
}

static void on_drive(const rect_message *message, void *context) {
    (void)message;
    *(volatile int *)context += 1;
}

static void on_lost(const char *reason, void *context) {
    check(strlen(reason) > 0, "there is a reason");
    *(volatile int *)context += 1000;
}

static void safety(rect_robot one, rect_robot two) {
    rect_deadman deadman;
    rect_fleet_stop stop;
    rect_stops stops;
    rect_code code;
    uint32_t confirmation;
    bool is_following;
    bool is_stopped;
    int calls = 0;
    const rect_payload neutral = rect_payload_json("0");
    check(rect_robot_deadman(two, "*/drive", 1, NULL, on_drive, on_lost, &calls, NULL, &deadman, &error) == RECT_CODE_OPTION,
          "the time is too short");
    must(rect_robot_deadman(two, "*/drive", TIMEOUT_MS, NULL, on_drive, on_lost, &calls, NULL, &deadman, &error), "deadman");
    must(rect_robot_wait_until_established(two, TIMEOUT_MS, &error), "wait_until_established");
    must(rect_robot_publish(one, "drive", &neutral, &error), "publish");
    do {
        must(rect_deadman_is_following(deadman, &is_following, &error), "is_following");
    } while (!is_following);
    must(rect_robot_fleet_stop(one, &stop, &error), "fleet_stop");
    must(rect_fleet_stop_press(stop, "smoke", &error), "press");
    must(rect_fleet_stop_is_stopped(stop, &is_stopped, &error), "is_stopped");
    must(rect_fleet_stop_pressed(stop, &stops, &error), "pressed");
    check(is_stopped && stops.len == 1 && equals(stops.items[0].reason, "smoke"), "the fleet is stopped");
    must(rect_drop(&stops.id, &error), "drop");
    do {
        code = rect_fleet_stop_wait_for_change(stop, RETRY_MS, &error);
        check(code == RECT_CODE_OK || code == RECT_CODE_TIMED_OUT, "wait_for_change");
        must(rect_fleet_stop_confirmation(stop, "wombat-2", &confirmation, &error), "confirmation");
    } while (confirmation != RECT_CONFIRMATION_CONFIRMED);
    do {
        must(rect_deadman_is_following(deadman, &is_following, &error), "is_following");
    } while (is_following);
    must(rect_fleet_stop_release(stop, &error), "release");
    /* The other robot has to know that, too: it refuses goals of actions while the fleet is stopped. */
    do {
        must(rect_fleet_stop_confirmation(stop, "wombat-2", &confirmation, &error), "confirmation");
    } while (confirmation != RECT_CONFIRMATION_CONFIRMED);
    must(rect_drop(&stop.id, &error), "drop");
    must(rect_drop(&deadman.id, &error), "drop");
    check(calls == 3001, "one command and three losses were reported");
}

static void logs(rect_robot one, rect_robot two) {
    rect_log_line line = {0};
    rect_log_options options = {0};
    rect_log_item item;
    rect_logs reading;
    rect_code code;
    size_t count = 0;
    must(rect_robot_log(one, RECT_LEVEL_INFO, "ready"), "log");
    line.level = RECT_LEVEL_WARN;
    line.text = "slow";
    line.fields = "{\"angle\":12.5}";
    line.file = __FILE__;
    must(rect_robot_log_line(one, &line), "log_line");
    options.level = RECT_LEVEL_WARN;
    do {
        must(rect_robot_logs(two, "wombat-1", &options, &reading, &error), "logs");
        while ((code = rect_logs_next(reading, TIMEOUT_MS, &item, &error)) == RECT_CODE_OK) {
            if (item.len > 0) {
                check(item.kind == RECT_LOG_ITEM_KIND_LINES && equals(item.robot, "wombat-1"), "they are lines of wombat-1");
                check(equals(item.lines[0].text, "slow") && equals(item.lines[0].source, "plain.c"), "the text and the source");
                check(equals(item.lines[0].fields, line.fields), "the fields");
            }
            count += item.len;
            must(rect_drop(&item.id, &error), "drop");
        }
        check(code == RECT_CODE_END, "the end is reported");
        must(rect_drop(&reading.id, &error), "drop");
    } while (count == 0);
    check(count == 1, "one line has this level");
    must(rect_robot_alert(one, RECT_LEVEL_WARN, "battery low", &error), "alert");
    must(rect_robot_alert_named(one, "battery", RECT_LEVEL_ERROR, "battery at 3 %", &error), "alert_named");
    must(rect_robot_clear_alert(one, "battery low", &error), "clear_alert");
    must(rect_robot_clear_alert(one, "battery", &error), "clear_alert");
}

static void on_dig(const rect_goal *goal, void *context) {
    const rect_payload news = rect_payload_text("digging");
    const rect_payload result = rect_payload_json("{\"depth\":3}");
    rect_string reason;
    *(volatile int *)context += 1;
    check(begins(goal->by, "wombat-1") && goal->goal_id.len > 0, "the goal has an id and a client");
    if (has_text(goal->payload, "fail")) {
        must(rect_goal_fail(goal->id, "there is rock", &error), "fail");
        check(rect_goal_done(goal->id, NULL, NULL) == RECT_CODE_ARGUMENT, "a goal has one end");
        return;
    }
    check(!rect_goal_is_cancelled(goal->id), "nobody has cancelled it");
    must(rect_goal_feedback(goal->id, &news, 0.5, &error), "feedback");
    if (has_text(goal->payload, "wait")) {
        check(rect_goal_sleep(goal->id, TIMEOUT_MS, &error) == RECT_CODE_CANCELLED, "the goal is cancelled");
        must(rect_goal_cancel_reason(goal->id, &reason, &error), "cancel_reason");
        check(begins(reason.text, "by wombat-1") && rect_goal_is_cancelled(goal->id), "the reason is known");
        must(rect_drop(&reason.id, &error), "drop");
        return;
    }
    must(rect_goal_sleep(goal->id, 1, &error), "sleep");
    must(rect_goal_done(goal->id, &result, &error), "done");
}

static void on_feedback(const rect_feedback *feedback, void *context) {
    check(has_text(feedback->value, "digging") && feedback->progress == 0.5, "the feedback is correct");
    *(volatile int *)context += 1;
}

static void end_of_goal(rect_robot one, const char *goal, rect_phase phase, const char *reason) {
    const rect_payload payload = rect_payload_text(goal);
    rect_start_options options = {0};
    rect_action_run run;
    rect_subscription subscription;
    rect_goal_status status;
    rect_buffer result;
    rect_code code;
    volatile int news = 0;
    options.goal_id = goal;
    options.feedback_per_s = 20;
    do {
        code = rect_robot_start(one, "wombat-2", "dig", &payload, &options, TIMEOUT_MS, &run, &error);
    } while (code == RECT_CODE_NO_ACTION);
    must(code, "start");
    if (strcmp(goal, "wait") == 0) {
        must(rect_action_run_on_feedback(run, on_feedback, (void *)&news, NULL, &subscription, &error), "on_feedback");
        do {
            code = rect_action_run_wait_for_change(run, RETRY_MS, &error);
            check(code == RECT_CODE_OK || code == RECT_CODE_TIMED_OUT, "wait_for_change");
        } while (news == 0);
        check(rect_action_run_result(run, RETRY_MS, &result, &error) == RECT_CODE_TIMED_OUT, "it has not ended");
        must(rect_action_run_cancel(run, &error), "cancel");
    }
    code = rect_action_run_result(run, TIMEOUT_MS, &result, &error);
    if (phase == RECT_PHASE_DONE) {
        must(code, "result");
        check(has_text(result.payload, "{\"depth\":3}"), "the result is JSON");
        must(rect_drop(&result.id, &error), "drop");
    }
    check((code == RECT_CODE_OK) == (phase == RECT_PHASE_DONE), "the end is correct");
    must(rect_action_run_status(run, &status, &error), "status");
    check(status.phase == (uint32_t)phase && begins(status.reason, reason), rect_phase_name(status.phase));
    check(status.is_reachable && equals(status.goal_id, goal) && equals(status.action, "dig"), "the status is complete");
    must(rect_drop(&status.id, &error), "drop");
    if (news > 0) {
        must(rect_drop(&subscription.id, &error), "drop");
    }
    must(rect_drop(&run.id, &error), "drop");
}

static void actions(rect_robot one, rect_robot two) {
    rect_action action;
    rect_action_options options = {0};
    rect_action_run run;
    rect_known_goals goals;
    int calls = 0;
    options.about = "digs a hole";
    options.refuse_when_busy = true;
    options.lost_after_ms = RECT_FOREVER;
    must(rect_robot_action(two, "dig", &options, on_dig, &calls, on_release, &action, &error), "action");
    check(rect_robot_start(one, "wombat-2", "fly", NULL, NULL, TIMEOUT_MS, &run, &error) == RECT_CODE_NO_ACTION, "no action");
    end_of_goal(one, "dig", RECT_PHASE_DONE, "");
    end_of_goal(one, "fail", RECT_PHASE_FAILED, "there is rock");
    end_of_goal(one, "wait", RECT_PHASE_CANCELLED, "by wombat-1");
    must(rect_robot_goals(one, "*", TIMEOUT_MS, &goals, &error), "goals");
    check(goals.len == 3 && equals(goals.items[0].robot, "wombat-2"), "the goals are known");
    check(goals.items[0].age_ms < TIMEOUT_MS * 10, "the state is new");
    must(rect_drop(&goals.id, &error), "drop");
    check(rect_robot_find(one, "wombat-2", "dig", "none", TIMEOUT_MS, &run, &error) == RECT_CODE_NO_GOAL, "no goal");
    must(rect_robot_find(one, "wombat-2", "dig", "fail", TIMEOUT_MS, &run, &error), "find");
    must(rect_drop(&run.id, &error), "drop");
    must(rect_drop(&action.id, &error), "drop");
    check(calls == 103, "each goal was carried out once, and the context was released");
    check(strcmp(rect_phase_name(RECT_PHASE_LOST), "lost") == 0 && *rect_phase_name(99) == 0, "phases have names");
}

int main(void) {
    rect_robot one;
    rect_robot two;
    rect_robot copy;
    causes();
    connect_pair(&one, &two);
    messages(one, two);
    retained(one, two);
    services(one, two);
    streams(one, two);
    transfers(one, two);
    parameters(one, two);
    safety(one, two);
    logs(one, two);
    actions(one, two);
    copy = one;
    must(rect_drop(&one.id, &error), "drop");
    check(rect_drop(&copy.id, &error) == RECT_CODE_HANDLE, "dropping a copy of a dropped handle fails");
    must(rect_drop(&two.id, &error), "drop");
    check(rect_handle_count() == 0, "all handles are dropped");
    printf("all passed\n");
    return 0;
}
