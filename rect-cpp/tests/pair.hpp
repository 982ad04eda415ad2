// Two robots' programs in one process, linked over TCP. What reaches whom is waited for, never slept for.
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

#include "catch_amalgamated.hpp"

using namespace std::chrono_literals;

// No step of any test takes this long, not even on a busy machine.
constexpr auto deadline = 60s;
// How long it takes to try again.
constexpr auto patience = 50ms;

// A place on this computer where nobody listens now.
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

// On any thread, which Catch2's own checks are not for.
using rect::must;

// Does it again and again until there is what is waited for.
template <class Done>
void until(Done done) {
    const auto end = std::chrono::steady_clock::now() + deadline;
    while (!done()) {
        REQUIRE(std::chrono::steady_clock::now() < end);
    }
}

// Something that happens on another thread, and is waited for.
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

// A program of that robot, without a router.
inline rect::Robot joined(const char* name, const std::string& listen, const std::string& dial) {
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

// `wombat-1` and `wombat-2`, each of which knows the other.
struct Pair {
    std::string endpoint = free_endpoint();
    rect::Robot one = joined("wombat-1", endpoint, "");
    rect::Robot two = joined("wombat-2", "", endpoint);

    Pair() {
        until([&] { return !must(one.peers()).empty() && !must(two.peers()).empty(); });
    }

    // The first message that `subscriber` gets, while `one` says it again and again: a subscription takes a moment to arrive.
    template <class T>
    rect::Message heard(const rect::Subscriber& subscriber, const char* topic, const T& value) {
        rect::expected<rect::Message> message = subscriber.next(0ms);
        until([&] {
            must(one.publish(topic, value));
            message = subscriber.next(patience);
            return message.has_value();
        });
        return std::move(*message);
    }
};

#endif
