/* A program in C99 with all that a robot does: says, hears, asks, serves, streams, transfers; what it has is dropped. */
#include <rect.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The first port that is tried to listen at. */
enum { PORT = 27447, PORTS = 200, PATIENCE_MS = 60000, TRY_MS = 50 };

static rect_error error;

static void must(rect_code code, const char *what) {
    if (code != RECT_CODE_OK) {
        fprintf(stderr, "%s: %s (%d)\n", what, error.text, (int)code);
        exit(1);
    }
}

static void check(bool holds, const char *what) {
    if (!holds) {
        fprintf(stderr, "%s does not hold\n", what);
        exit(1);
    }
}

static bool is(rect_text text, const char *wanted) {
    return text.len == strlen(wanted) && memcmp(text.data, wanted, text.len) == 0;
}

static bool says(rect_payload payload, const char *wanted) {
    rect_text text;
    must(rect_payload_as_text(&payload, &text, &error), "the text");
    return is(text, wanted);
}

/* Two programs, linked directly. */
static void join(rect_robot *one, rect_robot *two) {
    char endpoint[40];
    const char *there[] = {endpoint};
    rect_options options = {0};
    int port;
    options.login_file = "/none";
    options.listen = there;
    options.listen_len = 1;
    for (port = PORT;; ++port) {
        snprintf(endpoint, sizeof endpoint, "tcp/127.0.0.1:%d", port);
        rect_code code = rect_connect("wombat-1", &options, one, &error);
        if (code == RECT_CODE_OK) {
            break;
        }
        check(code == RECT_CODE_OPTION && port < PORT + PORTS, "there is a free port");
    }
    options.listen_len = 0;
    options.endpoints = there;
    options.endpoints_len = 1;
    must(rect_connect("wombat-2", &options, two, &error), "wombat-2");
}

static void on_message(const rect_message *message, void *context) {
    rect_robot *two = context;
    check(is(message->from, "wombat-1"), "the message is of wombat-1");
    must(rect_robot_publish(*two, "echo", &message->payload, NULL), "the echo");
}

static void on_request(const rect_request *request, void *context) {
    const rect_payload volt = rect_payload_json("{\"volt\":3.6}");
    (void)context;
    must(rect_request_reply(request->id, &volt, &error), "the answer");
    check(rect_request_refuse(request->id, &volt, NULL) == RECT_CODE_ARGUMENT, "it is answered once");
}

static void on_progress(const rect_progress *progress, void *context) { *(uint64_t *)context = progress->held_bytes; }

static void messages(rect_robot one, rect_robot two) {
    rect_subscription echoing;
    rect_subscriber heard;
    rect_message message;
    rect_robot urgent;
    rect_code code;
    char name[RECT_NAME_BYTES];
    const rect_payload hello = rect_payload_text("hello");
    must(rect_robot_on_message(two, "wombat-1/greeting", NULL, on_message, &two, NULL, &echoing, &error), "on_message");
    must(rect_robot_subscribe(one, "wombat-2/echo", NULL, &heard, &error), "subscribe");
    must(rect_robot_with(one, RECT_URGENCY_URGENT, &urgent, &error), "with");
    do {
        must(rect_robot_publish(urgent, "greeting", &hello, &error), "publish");
        code = rect_subscriber_next(heard, TRY_MS, &message, &error);
    } while (code == RECT_CODE_TIMED_OUT);
    must(code, "next");
    check(is(message.from, "wombat-2") && is(message.topic, "echo") && says(message.payload, "hello"), "the echo is heard");
    must(rect_drop(&message.id, &error), "drop");
    check(message.id == 0, "its id is gone");
    must(rect_robot_name(urgent, &name, &error), "name");
    check(strcmp(name, "wombat-1") == 0, "it has its name");
    must(rect_drop(&urgent.id, &error), "drop");
    must(rect_drop(&heard.id, &error), "drop");
    must(rect_drop(&echoing.id, &error), "drop");
}

static void services(rect_robot one, rect_robot two) {
    rect_service service;
    rect_reply reply;
    rect_code code;
    const rect_payload which = rect_payload_json("{\"cell\":1}");
    must(rect_robot_serve(two, "battery", on_request, NULL, NULL, &service, &error), "serve");
    do {
        code = rect_robot_request(one, "wombat-2", "battery", &which, PATIENCE_MS, &reply, &error);
    } while (code == RECT_CODE_NO_SERVICE);
    must(code, "request");
    check(is(reply.from, "wombat-2") && says(reply.payload, "{\"volt\":3.6}"), "the answer is right");
    must(rect_drop(&reply.id, &error), "drop");
    must(rect_drop(&service.id, &error), "drop");
}

static void streams(rect_robot one, rect_robot two) {
    rect_stream stream;
    rect_stream_options options = {0};
    rect_watch watch;
    rect_frame frame;
    rect_code code;
    const unsigned char value[] = {12, 34};
    const rect_payload payload = rect_payload_bytes(value, sizeof value);
    options.mode = RECT_STREAM_MODE_SENSOR;
    must(rect_robot_stream(one, "distance", &options, &stream, &error), "stream");
    must(rect_robot_watch(two, "wombat-1", "distance", NULL, &watch, &error), "watch");
    do {
        must(rect_stream_send(stream, &payload, NULL, &error), "send");
        code = rect_watch_next(watch, TRY_MS, &frame, &error);
    } while (code == RECT_CODE_TIMED_OUT);
    must(code, "next");
    check(frame.payload.len == 2 && memcmp(frame.payload.data, value, 2) == 0, "the frame is right");
    must(rect_drop(&frame.id, &error), "drop");
    must(rect_drop(&watch.id, &error), "drop");
    must(rect_drop(&stream.id, &error), "drop");
}

static void transfers(rect_robot one, rect_robot two) {
    rect_receive_options taking = {0};
    rect_transfer_options options = {0};
    rect_transfer transfer;
    rect_transfers transfers;
    rect_received received;
    uint64_t held = 0;
    taking.max_bytes = 1000;
    options.payload = rect_payload_text("a map");
    options.patience_ms = PATIENCE_MS;
    must(rect_robot_receive_transfers(two, "*/map", &taking, &transfers, &error), "receive_transfers");
    must(rect_robot_begin_transfer(one, "wombat-2", "map", &options, on_progress, &held, NULL, &transfer, &error), "transfer");
    must(rect_transfer_wait(transfer, PATIENCE_MS, &error), "wait");
    check(rect_transfer_wait(transfer, PATIENCE_MS, &error) == RECT_CODE_END, "its end is told once");
    must(rect_drop(&transfer.id, &error), "drop");
    must(rect_transfers_next(transfers, PATIENCE_MS, &received, &error), "next");
    check(held == 5 && received.size_bytes == 5 && says(received.payload, "a map"), "all of it is there");
    must(rect_drop(&received.id, &error), "drop");
    must(rect_drop(&transfers.id, &error), "drop");
}

int main(void) {
    rect_robot one;
    rect_robot two;
    rect_robot copy;
    join(&one, &two);
    messages(one, two);
    services(one, two);
    streams(one, two);
    transfers(one, two);
    copy = one;
    must(rect_drop(&one.id, &error), "drop");
    check(rect_drop(&copy.id, &error) == RECT_CODE_HANDLE, "dropped twice is an error");
    must(rect_drop(&two.id, &error), "drop");
    check(rect_live() == 0, "all is dropped");
    printf("all passed\n");
    return 0;
}
