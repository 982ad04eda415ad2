// Something that is counted on one thread and waited for on another.
#ifndef RECT_BENCHES_COUNTER_HPP
#define RECT_BENCHES_COUNTER_HPP

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <optional>

// Counts, and wakes who waits once there are as many as wanted: what more it did would be in the library's figures.
class Counter {
    using Clock = std::chrono::steady_clock;

public:
    void add() {
        if (count_.fetch_add(1) + 1 == wanted_) {
            const auto now = Clock::now();
            const std::lock_guard<std::mutex> lock(mutex_);
            reached_at_ = now;
            reached_.notify_one();
        }
    }
    // So many more, from now on.
    void want(long more) {
        const std::lock_guard<std::mutex> lock(mutex_);
        reached_at_.reset();
        wanted_ = count_ + more;
    }
    // When they were there, if that was in time.
    std::optional<Clock::time_point> wait(std::chrono::milliseconds time) {
        std::unique_lock<std::mutex> lock(mutex_);
        reached_.wait_for(lock, time, [&] { return reached_at_.has_value(); });
        return reached_at_;
    }

private:
    std::atomic<long> count_{0};
    std::atomic<long> wanted_{0};
    std::mutex mutex_;
    std::condition_variable reached_;
    std::optional<Clock::time_point> reached_at_;
};

#endif
