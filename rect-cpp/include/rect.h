// RECT in C, from C99 on. C++ has rect/rect.hpp on top of it.
//
// What every function asks of its caller:
//   * A pointer is NULL or points to what its type says, for as long as the call takes. Text ends in a zero byte; other
//     lengths are right. NULL where something has to be, or text that is not UTF-8, is RECT_CODE_ARGUMENT.
//   * `error` may be NULL. It is written when the call fails, and what the call gives only when it does not.
//   * What has an `id` is dropped by `rect_drop(&it.id, ..)`. Used after that it is RECT_CODE_HANDLE: ids are numbers that
//     are never used again, not addresses. What a struct with an id points to is gone then.
//   * Functions may be called on any thread, by several at a time, and in callbacks. What they call back runs on the thread
//     that is said there; it must not throw or longjmp. Nothing of RECT lives through a fork().


#ifndef RECT_H
#define RECT_H

/* Written by cbindgen of rect-cpp/src: change that, and write it anew. */

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

// The most dimensions of an array.
#define RECT_DIMENSIONS 8

// The longest text of an error, with the zero byte at its end.
#define RECT_ERROR_BYTES 1024

// The longest encoding, with the zero byte at its end.
#define RECT_ENCODING_BYTES 201

// The longest name of a robot, with the zero byte at its end.
#define RECT_NAME_BYTES 30

// How long a wait without end takes, for all `timeout_ms` of functions whose names end in `_next`.
#define RECT_FOREVER UINT32_MAX

// How a call ended. All but RECT_CODE_OK and RECT_CODE_END come with a text that says what to do.
typedef enum rect_code {
    // It is done.
    RECT_CODE_OK = 0,
    // There are no more: all have answered.
    RECT_CODE_END = 1,
    // It took longer than was allowed. Ask again, allow more time, or look at the link (`rect connections`).
    RECT_CODE_TIMED_OUT = 2,
    // An argument is NULL, not UTF-8, or out of its range; the text names it.
    RECT_CODE_ARGUMENT = 3,
    // What the handle was for has been dropped, or it is a handle of something else.
    RECT_CODE_HANDLE = 4,
    // The session was closed, or what is waited for was dropped meanwhile.
    RECT_CODE_CLOSED = 5,
    // The name of a robot or fleet. Choose another.
    RECT_CODE_NAME = 6,
    // A topic or pattern. Write it as the text says.
    RECT_CODE_TOPIC = 7,
    // A value that can't be sent or read as asked for.
    RECT_CODE_PAYLOAD = 8,
    // A codec that does not fit, or a payload that is damaged.
    RECT_CODE_CODEC = 9,
    // Bytes that are no dictionary, or samples that make none.
    RECT_CODE_DICTIONARY = 10,
    // No router. Start one, or name another.
    RECT_CODE_NO_ROUTER = 11,
    // A locator, or something else in the options, that Zenoh does not take.
    RECT_CODE_OPTION = 12,
    // Nobody has that service. Is the robot there, and does its program run?
    RECT_CODE_NO_SERVICE = 13,
    // The service answered with an error.
    RECT_CODE_SERVICE = 14,
    // Zenoh refuses.
    RECT_CODE_ZENOH = 15,
    // A transfer is not taken there.
    RECT_CODE_TRANSFER_REFUSED = 16,
    // A transfer began and ended before all was there. The text says whether to send it again.
    RECT_CODE_TRANSFER_FAILED = 17,
    // A file or folder of a transfer can't be used.
    RECT_CODE_FILE = 18,
    // A fault of RECT's own: please report it with its text.
    RECT_CODE_FAULT = 19,
    // A failure that this version of the header has no word for; the text tells.
    RECT_CODE_OTHER = 20,
    // The router asks for a login, and this program's is missing or wrong. Name the team's login file.
    RECT_CODE_LOGIN_REFUSED = 21,
    // The router serves another robot than the program joins as. Join under that name, or at the right router.
    RECT_CODE_WRONG_ROBOT = 22,
} rect_code;

// How far a connection is.
typedef enum rect_link_state {
    // There is a link.
    RECT_LINK_STATE_CONNECTED = 0,
    // It is dialled or waited for.
    RECT_LINK_STATE_CONNECTING = 1,
    // The robot is in the air, and there is no link with it.
    RECT_LINK_STATE_DISCOVERED = 2,
} rect_link_state;

// What has changed about who can be reached.
typedef enum rect_event_kind {
    // A robot of the fleet is there.
    RECT_EVENT_KIND_PEER_UP = 0,
    // It is gone.
    RECT_EVENT_KIND_PEER_DOWN = 1,
    // A link came up.
    RECT_EVENT_KIND_LINK_UP = 2,
    // It ended.
    RECT_EVENT_KIND_LINK_DOWN = 3,
    // This program's router is there.
    RECT_EVENT_KIND_ROUTER_UP = 4,
    // It is gone.
    RECT_EVENT_KIND_ROUTER_DOWN = 5,
} rect_event_kind;

// How urgently a robot speaks; more urgent messages overtake others in every queue and on the Bluetooth link.
typedef enum rect_urgency {
    // In no hurry.
    RECT_URGENCY_BULK = 0,
    // As usual.
    RECT_URGENCY_NORMAL = 1,
    // Before everything else.
    RECT_URGENCY_URGENT = 2,
} rect_urgency;

// What happens when one more comes than may wait.
typedef enum rect_when_full {
    // The oldest is dropped: what the program gets is fresh. The default.
    RECT_WHEN_FULL_NEWEST_WINS = 0,
    // The new one is dropped: what the program gets has no gap before it is full.
    RECT_WHEN_FULL_OLDEST_WINS = 1,
    // Whoever sends waits. Nothing is dropped, and a program that does not read holds up everything of that urgency that
    // comes over the same connection.
    RECT_WHEN_FULL_WAIT = 2,
} rect_when_full;

// How a stream is sent.
typedef enum rect_stream_mode {
    // Frames are as good as what gets through allows: pictures become smaller and coarser by themselves.
    RECT_STREAM_MODE_ADAPTIVE = 0,
    // Frames go as they are given, at most so often.
    RECT_STREAM_MODE_FIXED = 1,
    // A sensor's values: as they are, as often as they come, and nothing comes back.
    RECT_STREAM_MODE_SENSOR = 2,
} rect_stream_mode;

// What a pixel is; 8 bits each.
typedef enum rect_format {
    // Grey.
    RECT_FORMAT_GREY8 = 0,
    // Red, green, blue.
    RECT_FORMAT_RGB8 = 1,
    // Red, green, blue, and how opaque it is; not multiplied with that.
    RECT_FORMAT_RGBA8 = 2,
} rect_format;

// The type of an array's numbers.
typedef enum rect_element {
    // `uint8_t`.
    RECT_ELEMENT_U8 = 0,
    // `int8_t`.
    RECT_ELEMENT_I8 = 1,
    // `uint16_t`.
    RECT_ELEMENT_U16 = 2,
    // `int16_t`.
    RECT_ELEMENT_I16 = 3,
    // `uint32_t`.
    RECT_ELEMENT_U32 = 4,
    // `int32_t`.
    RECT_ELEMENT_I32 = 5,
    // `int64_t`.
    RECT_ELEMENT_I64 = 6,
    // `float`.
    RECT_ELEMENT_F32 = 7,
    // `double`.
    RECT_ELEMENT_F64 = 8,
} rect_element;

// Why a call did not do it. Every call that may fail takes a pointer to one, or NULL; it is written when the call fails,
// and left alone otherwise. It owns nothing.
typedef struct rect_error {
    // What the call returns, too.
    enum rect_code code;
    // For people: one line of UTF-8, with a zero byte at its end. What is longer is cut.
    char text[RECT_ERROR_BYTES];
} rect_error;

// Text that RECT gives: UTF-8, without a zero byte at its end, `printf("%.*s", (int)text.len, text.data)`. What is not
// there has the length 0. It lives as long as what it belongs to.
typedef struct rect_text {
    // The first byte; NULL where there is none.
    const uint8_t *data;
    // How many bytes.
    size_t len;
} rect_text;

// Bytes, and what they are. What a program gives is copied before the call returns; what it gets lives as long as what it
// is of.
typedef struct rect_payload {
    // The first byte.
    const void *data;
    // How many.
    size_t len;
    // What they are, as `application/json`; of length 0: any bytes.
    struct rect_text encoding;
} rect_payload;

// What may come out of one payload, whatever a peer sends.
typedef struct rect_limits {
    // The most bytes; 0: 64 MiB.
    size_t max_bytes;
    // The most pixels of a picture; 0: 16 million.
    size_t max_pixels;
} rect_limits;

// Numbers of one type, little endian, the last index running fastest. They are there until `rect_drop(&array.id, ..)`.
typedef struct rect_array {
    // Its handle.
    uint64_t id;
    // The type of its numbers: a `rect_element`.
    uint32_t element;
    // How many dimensions.
    uint32_t dimensions;
    // Its dimensions, the one that runs slowest first.
    size_t shape[RECT_DIMENSIONS];
    // The numbers, at an address that is a multiple of 8.
    const uint8_t *numbers;
    // How many bytes of them.
    size_t len;
} rect_array;

// A payload of its own. `rect_drop(&buffer.id, ..)` when it is not needed any more.
typedef struct rect_buffer {
    // Its handle.
    uint64_t id;
    // The payload.
    struct rect_payload payload;
} rect_buffer;

// A dictionary, with which small messages of the same kind become much smaller. `rect_drop(&dictionary.id, ..)` when it is
// not needed any more; robots that pack with it keep it.
typedef struct rect_dictionary {
    // Its handle.
    uint64_t id;
} rect_dictionary;

// A text of its own, as JSON. `rect_drop(&string.id, ..)` when it is not needed any more.
typedef struct rect_string {
    // Its handle.
    uint64_t id;
    // The text.
    struct rect_text text;
} rect_string;

// A program of a robot, joined with the others. `rect_drop(&robot.id, ..)` when it is not needed any more: the session ends
// with the last handle of it and of what was made by it, or with `rect_robot_close`.
//
// All functions that take one may be called by several threads at a time.
typedef struct rect_robot {
    // Its handle.
    uint64_t id;
} rect_robot;

// A connection of a robot's router (docs/registry.md). What is not known is an empty text, -1, or not a number (NAN).
typedef struct rect_connection {
    // Its name, if it is a named one.
    struct rect_text name;
    // `ble`, `tcp`, `udp`, ...
    struct rect_text method;
    // The other end.
    struct rect_text address;
    // The Zenoh id of who is there.
    struct rect_text peer_id;
    // Which robot that is.
    struct rect_text peer;
    // How far it is.
    enum rect_link_state state;
    // For how long, in s.
    double up_s;
    // What a small message takes there and back, in ms.
    double round_trip_ms;
    // How strong its signal is, in dBm.
    double rssi_dbm;
    // Bytes sent.
    int64_t sent_bytes;
    // Bytes received.
    int64_t received_bytes;
    // How often it was linked.
    int64_t linked;
    // How often it could not be.
    int64_t failed;
    // What went wrong last.
    struct rect_text last_error;
    // How long ago that was, in s.
    double last_error_ago_s;
} rect_connection;

// Connections. `rect_drop(&connections.id, ..)` when they are not needed any more.
typedef struct rect_connections {
    // Their handle.
    uint64_t id;
    // The first.
    const struct rect_connection *items;
    // How many.
    size_t len;
} rect_connections;

// A connection that a router is to have. What is 0 or NULL is left out.
typedef struct rect_named_connection {
    // Its name.
    const char *name;
    // `ble`, `tcp`, `udp`, or any other of Zenoh's protocols.
    const char *method;
    // For `ble` a robot's name or its Bluetooth address, else a host.
    const char *address;
    // For methods with one.
    uint16_t port;
    // For `ble`: the L2CAP channel's number; left out, the advertised one.
    uint16_t psm;
    // Options of the method's locator, a JSON object: `{"mtu": 512}`.
    const char *options;
} rect_named_connection;

// A picture: rows of pixels without gaps, from the upper left. It is there until `rect_drop(&picture.id, ..)`.
typedef struct rect_picture {
    // Its handle.
    uint64_t id;
    // Pixels of a row.
    uint32_t width;
    // Rows.
    uint32_t height;
    // What a pixel is: a `rect_format`.
    uint32_t format;
    // The pixels.
    const uint8_t *pixels;
    // How many bytes of them.
    size_t len;
} rect_picture;

// An answer; it is there until `rect_drop(&reply.id, ..)`.
typedef struct rect_reply {
    // Its handle.
    uint64_t id;
    // Who answers.
    struct rect_text from;
    // What it says.
    struct rect_payload payload;
} rect_reply;

// The answers to one request, as they come. `rect_drop(&replies.id, ..)` when no more are wanted, which cancels the request.
typedef struct rect_replies {
    // Its handle.
    uint64_t id;
} rect_replies;

// How to join, where the router of this computer does not do. What is 0 or NULL is left at its default, so that
// `rect_options options = {0};` changes nothing. It is read during the call only.
typedef struct rect_options {
    // The team's name; default `rect`.
    const char *fleet;
    // The router, as `tcp/192.168.0.7:7447`; default: what the environment's `RECT_ENDPOINT` says, else
    // `tcp/127.0.0.1:7447`.
    const char *router;
    // Without a router: connects to these directly, as `ble/wombat-2` or `udp/192.168.0.8:7447`. They are dialled until they
    // are there; joining does not wait for them.
    const char *const *endpoints;
    // How many endpoints.
    size_t endpoints_len;
    // Without a router: others may connect to this program there, as `tcp/0.0.0.0:7447` or `ble/hci0#name=wombat-1`.
    const char *const *listen;
    // How many places to listen at.
    size_t listen_len;
    // As that user, with `password`; default: the first line of the login file.
    const char *user;
    // The user's password.
    const char *password;
    // The file with the login, `user:password`; default: what the environment's `RECT_LOGIN` says, else `/etc/rect/users`.
    const char *login_file;
    // How long to wait for the router, in ms; default 5000, so that a program may be started together with it.
    uint32_t patience_ms;
    // Any settings of Zenoh's configuration: paths, as `transport/unicast/max_links`. They go before RECT's.
    const char *const *zenoh_keys;
    // Their values, in JSON: as many as there are keys.
    const char *const *zenoh_values;
    // How many settings.
    size_t zenoh_len;
    // Joins although the router serves another robot: for a program that uses another name on purpose. A router with access
    // control as `rect-router init` writes it drops what such a program publishes.
    bool allow_name_mismatch;
} rect_options;

// A message from another robot (or another program of this one). One that a call gives has an `id`, and is there until
// `rect_drop(&message.id, ..)`. One that a callback is called with has none, and is there until the callback returns.
typedef struct rect_message {
    // Its handle; 0 in callbacks.
    uint64_t id;
    // Who sent it.
    struct rect_text from;
    // To whom alone; nothing: to all.
    struct rect_text to;
    // About what.
    struct rect_text topic;
    // What it says.
    struct rect_payload payload;
    // When, by the sender's clock, in ms since 1970; -1 for one of a stock program. A robot without a clock of its own may
    // be years off.
    int64_t sent_ms;
    // Its number at its publisher; -1 for one of a stock program.
    int64_t sequence;
    // So many of its publisher, before it, did not arrive.
    uint32_t missed;
    // How urgent: a `rect_urgency`.
    uint32_t urgency;
    // It was overtaken on its way.
    bool late;
    // Why it is still packed as it came, if it is: it is damaged, or of a codec that is not known here.
    struct rect_text flaw;
    // By what it came, as `ble`, where its sender has one link with this robot, and that is known.
    struct rect_text over;
} rect_message;

// Names of robots. `rect_drop(&names.id, ..)` when they are not needed any more.
typedef struct rect_names {
    // Their handle.
    uint64_t id;
    // The first.
    const struct rect_text *items;
    // How many.
    size_t len;
} rect_names;

// What a program has said and heard, since it joined.
typedef struct rect_counters {
    // Messages said, answers and requests not counted.
    uint64_t sent;
    // Their payloads, in bytes, as they were sent.
    uint64_t sent_bytes;
    // Messages heard, each subscription's.
    uint64_t received;
    // Their payloads, in bytes, as they came.
    uint64_t received_bytes;
    // Messages that did not arrive, by their numbers.
    uint64_t missed;
    // Messages of other Zenoh programs that were dropped because RECT does not allow their topic (control characters, more
    // than 200 bytes, reserved parts).
    uint64_t rejected;
} rect_counters;

// A request, which is there until the callback returns. It is answered by `rect_request_reply` or `rect_request_refuse`
// before that, on any thread; one that was not is refused.
typedef struct rect_request {
    // Its handle.
    uint64_t id;
    // Who asks; nothing: a stock program, which does not say.
    struct rect_text from;
    // What is asked.
    struct rect_payload payload;
    // How long an answer is of use still, in ms.
    uint32_t remaining_ms;
} rect_request;

// Called with a request, which is there until it returns.
typedef void (*rect_on_request)(const struct rect_request *request, void *context);

// Called once when a callback will not be called any more, with its `context`; may be NULL. That is so even where the call
// that it was given to fails.
typedef void (*rect_release)(void *context);

// A service, until `rect_drop(&service.id, ..)`; that waits for calls that are under way. It may be dropped in its own
// callback, whose answer is not sent then.
typedef struct rect_service {
    // Its handle.
    uint64_t id;
} rect_service;

// A change of who can be reached. It is there until the callback returns.
typedef struct rect_event {
    // What.
    enum rect_event_kind kind;
    // Which robot; of a link nothing, where that is not known.
    struct rect_text robot;
    // The protocol of a link, as `ble`.
    struct rect_text method;
    // Its other end.
    struct rect_text address;
} rect_event;

// Called with a change, which is there until it returns.
typedef void (*rect_on_state)(const struct rect_event *event, void *context);

// A callback that is called for whatever comes, one after another, on a thread of its own, until
// `rect_drop(&subscription.id, ..)`; that waits for a call that is under way. It may be dropped in its own callback. Two
// callbacks that drop each other's at the same time wait for each other for ever.
typedef struct rect_subscription {
    // Its handle.
    uint64_t id;
} rect_subscription;

// How a stream is sent. `rect_stream_options options = {0};` is adaptive, and so is NULL; what is 0 is left at its default.
typedef struct rect_stream_options {
    // A `rect_stream_mode`.
    uint32_t mode;
    // Pictures with a quality are written as WebP instead of JPEG: smaller, and several times as long to write.
    bool webp;
    // Not more frames per second than that; default 15. For a fixed one it has to be given.
    double most_frames_per_s;
    // Frames per second that are wanted even of the smallest; default 5.
    double least_frames_per_s;
} rect_stream_options;

// A stream that this program sends, of which the newest frame counts. `rect_drop(&stream.id, ..)` ends it.
typedef struct rect_stream {
    // Its handle.
    uint64_t id;
} rect_stream;

// How what comes waits for the program. `rect_receiving receiving = {0};` is the default, and so is NULL.
typedef struct rect_receiving {
    // How many may wait; 0: 256 messages, or the newest frame alone.
    size_t capacity;
    // What happens to more: a `rect_when_full`.
    uint32_t when_full;
} rect_receiving;

// The messages of a pattern, which wait until they are taken. `rect_drop(&subscriber.id, ..)` when no more are wanted.
typedef struct rect_subscriber {
    // Its handle.
    uint64_t id;
} rect_subscriber;

// Called with a message, which is there until it returns.
typedef void (*rect_on_message)(const struct rect_message *message, void *context);

// What is transferred, and how. What is 0 or NULL is left at its default.
typedef struct rect_transfer_options {
    // A file, by its path. It must not change before all is there. NULL: `payload` is transferred.
    const char *file;
    // Bytes, where there is no file.
    struct rect_payload payload;
    // What it is called there; default: the file's name, and bytes have none.
    const char *name;
    // What a file is; default `zenoh/bytes`.
    const char *encoding;
    // How long nothing may be heard of the receiver, in ms; default: it may come back whenever it likes.
    uint32_t patience_ms;
} rect_transfer_options;

// How much of a transfer the receiver holds.
typedef struct rect_progress {
    // What it holds.
    uint64_t held_bytes;
    // Of how many.
    uint64_t size_bytes;
} rect_progress;

// Called with how much is there, up to ten times a second, on the transfer's thread.
typedef void (*rect_on_progress)(const struct rect_progress *progress, void *context);

// A transfer that this program sends. `rect_drop(&transfer.id, ..)` ends it, all there or not.
typedef struct rect_transfer {
    // Its handle.
    uint64_t id;
} rect_transfer;

// How transfers are taken. What is 0 or NULL is left at its default.
typedef struct rect_receive_options {
    // Into a folder for each sender in this one, under the name that the sender gives; NULL: into memory. What came into
    // files goes on after a restart.
    const char *folder;
    // The largest that is taken, in bytes. It has to be given.
    uint64_t max_bytes;
    // How many at once, half of them of one sender at most; others wait. Default 4.
    size_t at_once;
    // How long nothing may come before one is given up, in ms; default 600000.
    uint32_t patience_ms;
} rect_receive_options;

// The transfers that come. `rect_drop(&transfers.id, ..)` when no more are wanted.
typedef struct rect_transfers {
    // Its handle.
    uint64_t id;
} rect_transfers;

// A transfer that came, with the right checksum. It is there until `rect_drop(&received.id, ..)`; a file stays.
typedef struct rect_received {
    // Its handle.
    uint64_t id;
    // Of whom.
    struct rect_text from;
    // About what.
    struct rect_text topic;
    // What its sender calls it; may be empty.
    struct rect_text name;
    // The file that it is in; nothing, where it is in memory.
    struct rect_text file;
    // What it is, and its bytes, unless they are in a file.
    struct rect_payload payload;
    // How long it is.
    uint64_t size_bytes;
} rect_received;

// A stream that this program watches. `rect_drop(&watch.id, ..)` when no more frames are wanted.
typedef struct rect_watch {
    // Its handle.
    uint64_t id;
} rect_watch;

// A frame of a stream. One that a call gives has an `id`, and is there until `rect_drop(&frame.id, ..)`. One that a callback
// is called with has none, and is there until the callback returns.
typedef struct rect_frame {
    // Its handle; 0 in callbacks.
    uint64_t id;
    // What it is.
    struct rect_payload payload;
    // How old it was when it came, in us; until the sender has told its time, how much older than the fastest of the last
    // minute. -1: another program's, which does not tell.
    int64_t age_us;
    // Its number. The sender numbers anew when it starts, and when this robot gets other frames than before.
    uint32_t number;
    // So many before it were not seen: the link dropped them, or this program was not there to take them.
    uint32_t skipped;
} rect_frame;

// Called with a frame, which is there until it returns.
typedef void (*rect_on_frame)(const struct rect_frame *frame, void *context);

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// The encoding of an array, which goes with its numbers, little endian, into a payload. `element`: a `rect_element`;
// `len`: of the numbers, in bytes, which have to be as many as its shape says.
//
// Thread: any.
enum rect_code rect_array_encoding(uint32_t element,
                                   const size_t *shape,
                                   size_t dimensions,
                                   const void *numbers,
                                   size_t len,
                                   char (*encoding)[RECT_ENCODING_BYTES],
                                   struct rect_error *error);

// The array in a payload, raw or quantised. `limits`: NULL for the default.
//
// Thread: any.
enum rect_code rect_array_read(const struct rect_payload *payload,
                               const struct rect_limits *limits,
                               struct rect_array *array,
                               struct rect_error *error);

// A payload made smaller by a codec: `zstd:9`, `jpeg:60`, `webp:60`, `png`, `quantised:0.01`. `rect_robot_encoded` does so
// for all that a robot says.
//
// Thread: any. Takes as long as the codec.
enum rect_code rect_encode(const char *codec,
                           const struct rect_payload *payload,
                           struct rect_buffer *buffer,
                           struct rect_error *error);

// A payload without its packings (`;zstd`). What comes by a robot has none any more: this is for what was kept elsewhere.
// `dictionary`: NULL, or the one that it was packed with; `limits`: NULL for the default.
//
// Thread: any.
enum rect_code rect_unpack(const struct rect_payload *payload,
                           const struct rect_dictionary *dictionary,
                           const struct rect_limits *limits,
                           struct rect_buffer *buffer,
                           struct rect_error *error);

// The whole name of a codec, with the options that were left out: `zstd:3` for `zstd`.
//
// Thread: any.
enum rect_code rect_codec_name(const char *codec,
                               struct rect_string *name,
                               struct rect_error *error);

// The connections of a router. `of`: of which robot; NULL: this one. `which`: NULL for all, or as `method=ble`,
// `peer=wombat-2;state=connected` (docs/registry.md).
//
// Thread: any. Waits for the router's answer.
enum rect_code rect_robot_connections(struct rect_robot robot,
                                      const char *of,
                                      const char *which,
                                      struct rect_connections *connections,
                                      struct rect_error *error);

// Any question of the registry, as `connections/count` or `status` (docs/registry.md); the answer is JSON. `of` and `which`
// as `rect_robot_connections`.
//
// Thread: any. Waits for the router's answer.
enum rect_code rect_robot_ask_registry(struct rect_robot robot,
                                       const char *of,
                                       const char *question,
                                       const char *which,
                                       struct rect_string *answer,
                                       struct rect_error *error);

// Gives a router a connection, instead of the one of that name if it has one; it is dialled from now on, and after a
// restart. `of`: of which robot, whose access control has to allow that; NULL: this one.
//
// Thread: any. Waits for the router's answer.
enum rect_code rect_robot_add_connection(struct rect_robot robot,
                                         const char *of,
                                         const struct rect_named_connection *connection,
                                         struct rect_error *error);

// Takes a connection from a router; its link ends. `of` as `rect_robot_add_connection`.
//
// Thread: any. Waits for the router's answer.
enum rect_code rect_robot_remove_connection(struct rect_robot robot,
                                            const char *of,
                                            const char *name,
                                            struct rect_error *error);

// Makes one, at most `size` bytes large (512 to 131072; 4 to 16 kB is good for JSON), of messages like those to come: some
// hundred, ten times its size together.
//
// Thread: any. Takes a while.
enum rect_code rect_dictionary_train(const struct rect_payload *samples,
                                     size_t samples_len,
                                     size_t size,
                                     struct rect_dictionary *dictionary,
                                     struct rect_error *error);

// Reads a standard zstd dictionary of `len` bytes.
//
// Thread: any.
enum rect_code rect_dictionary_read(const void *data,
                                    size_t len,
                                    struct rect_dictionary *dictionary,
                                    struct rect_error *error);

// The number that messages name it by: made from its content, so that it is the same everywhere.
//
// Thread: any.
enum rect_code rect_dictionary_number(struct rect_dictionary dictionary,
                                      uint32_t *number,
                                      struct rect_error *error);

// Drops what an `id` is of, whatever that is, and sets it to 0; what is 0 stays so, as `free(NULL)`. No callback of it runs
// any more when this returns, except the one that calls this. Dropped a second time by a copy of the `id`, it is
// RECT_CODE_HANDLE, and nothing else happens. Two threads may drop the same variable at the same time: one of them does it.
//
// Thread: any.
enum rect_code rect_drop(uint64_t *id,
                         struct rect_error *error);

// How many things have an `id` now: a test that ends with as many as it began has dropped all that it had.
//
// Thread: any.
size_t rect_live(void);

// Whether a text may be the name of a robot or a fleet; if not, why.
//
// Thread: any.
enum rect_code rect_check_name(const char *name, struct rect_error *error);

// Whether a text may be the topic of a message; if not, why.
//
// Thread: any.
enum rect_code rect_check_topic(const char *topic, struct rect_error *error);

// Whether a text may be the pattern of a subscription; if not, why.
//
// Thread: any.
enum rect_code rect_check_pattern(const char *pattern, struct rect_error *error);

// A payload of text; NULL is no text. It points to what is given.
struct rect_payload rect_payload_text(const char *text);

// A payload of JSON, as some JSON library has written it; NULL is no text. It points to what is given.
struct rect_payload rect_payload_json(const char *text);

// A payload of any bytes. It points to what is given.
struct rect_payload rect_payload_bytes(const void *data, size_t len);

// The text in a payload: RECT_CODE_PAYLOAD if it says that it is something else, or is no UTF-8. It lives as long as the
// payload.
//
// Thread: any.
enum rect_code rect_payload_as_text(const struct rect_payload *payload,
                                    struct rect_text *out,
                                    struct rect_error *error);

// A picture as a payload, uncompressed: `rect_encode` makes it smaller. `len`: of the pixels, in bytes.
//
// Thread: any.
enum rect_code rect_picture_payload(uint32_t width,
                                    uint32_t height,
                                    uint32_t format,
                                    const void *pixels,
                                    size_t len,
                                    struct rect_buffer *buffer,
                                    struct rect_error *error);

// The picture in a payload: a raw one, PNG, JPEG or WebP. `limits`: NULL for the default.
//
// Thread: any. Takes as long as reading it.
enum rect_code rect_picture_read(const struct rect_payload *payload,
                                 const struct rect_limits *limits,
                                 struct rect_picture *picture,
                                 struct rect_error *error);

// Asks a service of the robot `of`, and waits for its first answer. RECT_CODE_SERVICE: it answers with an error, which is
// the text; RECT_CODE_NO_SERVICE: nobody serves that there.
//
// Thread: any.
enum rect_code rect_robot_request(struct rect_robot robot,
                                  const char *of,
                                  const char *topic,
                                  const struct rect_payload *payload,
                                  uint32_t timeout_ms,
                                  struct rect_reply *reply,
                                  struct rect_error *error);

// Asks a service of all robots that have it; answers come until all have answered, or the time is over.
//
// Thread: any.
enum rect_code rect_robot_request_all(struct rect_robot robot,
                                      const char *topic,
                                      const struct rect_payload *payload,
                                      uint32_t timeout_ms,
                                      struct rect_replies *replies,
                                      struct rect_error *error);

// The next answer. RECT_CODE_SERVICE: this one is an error, and there may be more; RECT_CODE_END: all have answered;
// RECT_CODE_TIMED_OUT: the time of the request is over, and some have not.
//
// Thread: any; one after another.
enum rect_code rect_replies_next(struct rect_replies replies,
                                 struct rect_reply *reply,
                                 struct rect_error *error);

// The version of the library, as `0.1.0`.
//
// Thread: any.
const char *rect_version(void);

// Joins as a program of the robot `name`. `options`: NULL for the router of this computer.
//
// Thread: any. Waits until the router answers, at most `options.patience_ms`.
enum rect_code rect_connect(const char *name,
                            const struct rect_options *options,
                            struct rect_robot *robot,
                            struct rect_error *error);

// The same robot, speaking with an urgency (`rect_urgency`): a handle of its own, which shares the session.
//
// Thread: any.
enum rect_code rect_robot_with(struct rect_robot robot,
                               uint32_t urgency,
                               struct rect_robot *same,
                               struct rect_error *error);

// The same robot; what it says goes through a codec: `zstd:9`, `jpeg:60`, `webp:60`, `png`, `quantised:0.01`. A handle of its
// own, which shares the session.
//
// Thread: any.
enum rect_code rect_robot_encoded(struct rect_robot robot,
                                  const char *codec,
                                  struct rect_robot *same,
                                  struct rect_error *error);

// The same robot; what it says is packed with that dictionary, which small JSON needs to get much smaller. Whoever hears it
// fetches the dictionary once. A handle of its own, which shares the session.
//
// Thread: any.
enum rect_code rect_robot_packed_with(struct rect_robot robot,
                                      struct rect_dictionary dictionary,
                                      struct rect_robot *same,
                                      struct rect_error *error);

// Writes the robot's name to `name`, which has room for RECT_NAME_BYTES, with a zero byte at its end.
//
// Thread: any.
enum rect_code rect_robot_name(struct rect_robot robot,
                               char (*name)[RECT_NAME_BYTES],
                               struct rect_error *error);

// Says it to all.
//
// Thread: any. Waits for room where a large payload finds none.
enum rect_code rect_robot_publish(struct rect_robot robot,
                                  const char *topic,
                                  const struct rect_payload *payload,
                                  struct rect_error *error);

// Says it to one robot alone. Nobody is asked whether it is there: `rect_robot_request` does that.
//
// Thread: any. Waits for room where a large payload finds none.
enum rect_code rect_robot_send(struct rect_robot robot,
                               const char *to,
                               const char *topic,
                               const struct rect_payload *payload,
                               struct rect_error *error);

// The next message of the robot `from` about `topic`, to all or to this one alone, that is sent from now on;
// RECT_CODE_TIMED_OUT: there was none.
//
// Thread: any.
enum rect_code rect_robot_listen(struct rect_robot robot,
                                 const char *from,
                                 const char *topic,
                                 uint32_t timeout_ms,
                                 struct rect_message *message,
                                 struct rect_error *error);

// The other robots of the fleet that are there now, by name.
//
// Thread: any. Waits for the router's answer.
enum rect_code rect_robot_peers(struct rect_robot robot,
                                struct rect_names *names,
                                struct rect_error *error);

// What this program has said and heard.
//
// Thread: any.
enum rect_code rect_robot_counters(struct rect_robot robot,
                                   struct rect_counters *counters,
                                   struct rect_error *error);

// Ends the session now, and all that belongs to it, whoever has handles of it. They are dropped as before.
//
// Thread: any, in callbacks too.
enum rect_code rect_robot_close(struct rect_robot robot,
                                struct rect_error *error);

// Serves `topic` by a function: others ask for it with `rect_robot_request`. Up to 16 requests are worked on at a time, on
// threads for such work, until the service is dropped. `release` is called with `context` once, when there will be no more
// calls, even where this call fails.
//
// Thread: any. The callback may be called on several threads at once; it may call any function of RECT, and drop its own
// service.
enum rect_code rect_robot_serve(struct rect_robot robot,
                                const char *topic,
                                rect_on_request callback,
                                void *context,
                                rect_release release,
                                struct rect_service *service,
                                struct rect_error *error);

// Answers; `request` is its `id`.
//
// Thread: any, until the callback returns.
enum rect_code rect_request_reply(uint64_t request,
                                  const struct rect_payload *payload,
                                  struct rect_error *error);

// Answers with an error, which the asker gets as RECT_CODE_SERVICE; `request` is its `id`.
//
// Thread: any, until the callback returns.
enum rect_code rect_request_refuse(uint64_t request,
                                   const struct rect_payload *payload,
                                   struct rect_error *error);

// Calls `callback` for each change of who can be reached, and first of all for who is there already: robots that come and
// go, links of this robot's router (without a router, of this program) and over which radio, and the router itself. One
// after another, on a thread of its own, until the subscription is dropped. `release` is called with `context` once, when
// there will be no more calls, even where this call fails.
//
// Thread: any. The callback may call any function of RECT, and drop its own subscription.
enum rect_code rect_robot_on_state(struct rect_robot robot,
                                   rect_on_state callback,
                                   void *context,
                                   rect_release release,
                                   struct rect_subscription *subscription,
                                   struct rect_error *error);

// A stream of which the newest frame counts: what is old, a slow link drops.
//
// Thread: any.
enum rect_code rect_robot_stream(struct rect_robot robot,
                                 const char *topic,
                                 const struct rect_stream_options *settings,
                                 struct rect_stream *stream,
                                 struct rect_error *error);

// Sends a frame as it is, if anyone wants one now. Does not wait for the link. `sent`: to how many groups of receivers it
// went, 0 to 2; may be NULL.
//
// Thread: any; of several threads' frames one goes out after another.
enum rect_code rect_stream_send(struct rect_stream stream,
                                const struct rect_payload *frame,
                                uint32_t *sent,
                                struct rect_error *error);

// Sends a picture, at the size and quality that get through: rows of pixels without gaps, from the upper left. Nothing is
// written while nobody wants one. `format`: a `rect_format`; `len`: of the pixels, in bytes; `sent`: as `rect_stream_send`.
//
// Thread: any; of several threads' frames one goes out after another. Takes as long as writing the picture.
enum rect_code rect_stream_send_picture(struct rect_stream stream,
                                        uint32_t width,
                                        uint32_t height,
                                        uint32_t format,
                                        const void *pixels,
                                        size_t len,
                                        uint32_t *sent,
                                        struct rect_error *error);

// What goes out, what gets through, and why it is as it is: JSON, with `groups` and `receivers` (docs/streams.md).
//
// Thread: any.
enum rect_code rect_stream_status(struct rect_stream stream,
                                  struct rect_string *status,
                                  struct rect_error *error);

// The messages of a pattern, `<robot>/<topic>` with wildcards, as `*/arm/*`: what those robots say to all, and to this one
// alone. `receiving`: NULL for the default.
//
// Thread: any.
enum rect_code rect_robot_subscribe(struct rect_robot robot,
                                    const char *pattern,
                                    const struct rect_receiving *receiving,
                                    struct rect_subscriber *subscriber,
                                    struct rect_error *error);

// The next message; RECT_CODE_TIMED_OUT: there was none within `timeout_ms` (RECT_FOREVER: it waits as long as it takes);
// RECT_CODE_CLOSED: the session was closed, or another thread dropped the subscriber.
//
// Thread: any; of several that wait, one gets it.
enum rect_code rect_subscriber_next(struct rect_subscriber subscriber,
                                    uint32_t timeout_ms,
                                    struct rect_message *message,
                                    struct rect_error *error);

// How many messages were dropped because the program did not take them in time.
//
// Thread: any.
enum rect_code rect_subscriber_dropped(struct rect_subscriber subscriber,
                                       uint64_t *dropped,
                                       struct rect_error *error);

// Calls `callback` for each message of a pattern, one after another, on a thread of its own, until the subscription is
// dropped. `release` is called with `context` once, when there will be no more calls, even where this call fails.
//
// Thread: any. The callback may call any function of RECT, and drop its own subscription.
enum rect_code rect_robot_on_message(struct rect_robot robot,
                                     const char *pattern,
                                     const struct rect_receiving *receiving,
                                     rect_on_message callback,
                                     void *context,
                                     rect_release release,
                                     struct rect_subscription *subscription,
                                     struct rect_error *error);

// Begins to transfer a file or bytes of any size to one robot, until it ends or is dropped. Everything else overtakes it.
// Links may come and go meanwhile, and either side may be restarted: it goes on where it was. `progress`: NULL, or called
// with `context` on the transfer's thread. `release` is called with `context` once, when there will be no more calls, even
// where this call fails.
//
// Thread: any. The callback may drop its own transfer, and must not wait for it.
enum rect_code rect_robot_begin_transfer(struct rect_robot robot,
                                         const char *to,
                                         const char *topic,
                                         const struct rect_transfer_options *options,
                                         rect_on_progress progress,
                                         void *context,
                                         rect_release release,
                                         struct rect_transfer *transfer,
                                         struct rect_error *error);

// Waits until all is there and right, or can't be. RECT_CODE_TIMED_OUT: it goes on after `timeout_ms` (RECT_FOREVER: it waits
// as long as it takes); RECT_CODE_CLOSED: the session was closed, or another thread dropped it; RECT_CODE_END: its end was
// told before.
//
// Thread: any but the transfer's own, on which its callback runs.
enum rect_code rect_transfer_wait(struct rect_transfer transfer,
                                  uint32_t timeout_ms,
                                  struct rect_error *error);

// Takes the transfers of a pattern, as `*/maps/*`, that others send to this robot, until it is dropped. Without it none is
// taken.
//
// Thread: any.
enum rect_code rect_robot_receive_transfers(struct rect_robot robot,
                                            const char *pattern,
                                            const struct rect_receive_options *options,
                                            struct rect_transfers *transfers,
                                            struct rect_error *error);

// The next transfer that ended: all of it, or RECT_CODE_TRANSFER_FAILED, and there may be more. RECT_CODE_TIMED_OUT: none did
// within `timeout_ms` (RECT_FOREVER: it waits as long as it takes); RECT_CODE_CLOSED: the session was closed, or another
// thread dropped it.
//
// Thread: any; of several that wait, one gets it.
enum rect_code rect_transfers_next(struct rect_transfers transfers,
                                   uint32_t timeout_ms,
                                   struct rect_received *received,
                                   struct rect_error *error);

// Watches a robot's stream: the newest frame waits until it is taken, or as many as `receiving` says.
//
// Thread: any.
enum rect_code rect_robot_watch(struct rect_robot robot,
                                const char *from,
                                const char *topic,
                                const struct rect_receiving *receiving,
                                struct rect_watch *watch,
                                struct rect_error *error);

// The next frame; RECT_CODE_TIMED_OUT: there was none within `timeout_ms` (RECT_FOREVER: it waits as long as it takes);
// RECT_CODE_CLOSED: the session was closed, or another thread dropped the watch.
//
// Thread: any; of several that wait, one gets it.
enum rect_code rect_watch_next(struct rect_watch watch,
                               uint32_t timeout_ms,
                               struct rect_frame *frame,
                               struct rect_error *error);

// Calls `callback` for each frame of a robot's stream, one after another, on a thread of its own, until the subscription is
// dropped; while it runs, older frames are dropped as `receiving` says. `release` is called with `context` once, when
// there will be no more calls, even where this call fails.
//
// Thread: any. The callback may call any function of RECT, and drop its own subscription.
enum rect_code rect_robot_on_frame(struct rect_robot robot,
                                   const char *from,
                                   const char *topic,
                                   const struct rect_receiving *receiving,
                                   rect_on_frame callback,
                                   void *context,
                                   rect_release release,
                                   struct rect_subscription *subscription,
                                   struct rect_error *error);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* RECT_H */
