// A counter that one thread increments and another one waits for.
#ifndef RECT_BENCHES_COUNTER_HPP
#define RECT_BENCHES_COUNTER_HPP

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <optional>

// Counts, and wakes the waiting thread at the expected count. It does nothing else, because its time is in the figures.
class Counter {
    using Clock = std::chrono::steady_clock;

public:
    void add() {
        if (count_.fetch_add(1) + 1 == expected_) {
            const auto now = Clock::now();
            const std::lock_guard<std::mutex> lock(mutex_);
            reached_at_ = now;
            reached_.notify_one();
        }
    }
    // Expects `more` counts from now on.
    void expect_more(long more) {
        const std::lock_guard<std::mutex> lock(mutex_);
        reached_at_.reset();
        expected_ = count_ + more;
    }
    // Waits for the expected count, and returns the time at which it was reached, or nothing after `time`.
    std::optional<Clock::time_point> wait(std::chrono::milliseconds time) {
        std::unique_lock<std::mutex> lock(mutex_);
        reached_.wait_for(lock, time, [&] { return reached_at_.has_value(); });
        return reached_at_;
    }

private:
    std::atomic<long> count_{0};
    std::atomic<long> expected_{0};
    std::mutex mutex_;
    std::condition_variable reached_;
    std::optional<Clock::time_point> reached_at_;
};

#endif
