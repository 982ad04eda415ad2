// Provides programs of two robots in one process, linked over TCP, and helpers that wait for conditions instead of sleeping.
#ifndef RECT_TESTS_PAIR_HPP
#define RECT_TESTS_PAIR_HPP

#include <arpa/inet.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <rect.hpp>
#include <string>

#include "catch.hpp"

using namespace std::chrono_literals;

// Longer than any step of a test takes, even on a busy machine.
constexpr auto deadline = 60s;
// How long a test waits before it retries.
constexpr auto retry_interval = 50ms;

// Returns an endpoint of this computer that is not in use.
inline std::string free_endpoint() {
    const int probe = socket(AF_INET, SOCK_STREAM, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t len = sizeof address;
    auto* any = reinterpret_cast<sockaddr*>(&address);
    REQUIRE(probe >= 0);
    REQUIRE(bind(probe, any, sizeof address) == 0);
    REQUIRE(getsockname(probe, any, &len) == 0);
    close(probe);
    return "tcp/127.0.0.1:" + std::to_string(ntohs(address.sin_port));
}

// Works on any thread, unlike the checks of Catch2.
using rect::must;

// Calls `done` repeatedly until it returns true.
template <class Done>
void until(Done done) {
    const auto end = std::chrono::steady_clock::now() + deadline;
    while (!done()) {
        REQUIRE(std::chrono::steady_clock::now() < end);
    }
}

// A flag that one thread sets and another one waits for.
class Flag {
public:
    void set() {
        const std::lock_guard<std::mutex> lock(mutex_);
        is_set_ = true;
        changed_.notify_all();
    }
    bool wait(std::chrono::milliseconds time = deadline) {
        std::unique_lock<std::mutex> lock(mutex_);
        return changed_.wait_for(lock, time, [&] { return is_set_; });
    }

private:
    std::mutex mutex_;
    std::condition_variable changed_;
    bool is_set_ = false;
};

// Connects a program without a router: it listens on `listen` and dials `dial`.
inline rect::Robot connect_without_router(const char* name, const std::string& listen, const std::string& dial) {
    rect::Options options;
    options.login_file = "/none";
    if (!listen.empty()) {
        options.listen = {listen};
    }
    if (!dial.empty()) {
        options.endpoints = {dial};
    }
    return must(rect::connect(name, options));
}

// The robots `wombat-1` and `wombat-2`, after each has discovered the other.
struct Pair {
    std::string endpoint = free_endpoint();
    rect::Robot one = connect_without_router("wombat-1", endpoint, "");
    rect::Robot two = connect_without_router("wombat-2", "", endpoint);

    Pair() {
        until([&] { return !must(one.peers()).empty() && !must(two.peers()).empty(); });
    }

    // Publishes a value repeatedly until `subscriber` receives it, because a subscription takes a moment to reach the publisher.
    template <class T>
    rect::Message publish_until_received(const rect::Subscriber& subscriber, const char* topic, const T& value) {
        rect::expected<rect::Message> message = subscriber.next(0ms);
        until([&] {
            must(one.publish(topic, value));
            message = subscriber.next(retry_interval);
            return message.has_value();
        });
        return std::move(*message);
    }
};

#endif
