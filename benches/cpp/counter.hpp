// Something that is counted on one thread and waited for on another.
#ifndef RECT_BENCHES_COUNTER_HPP
#define RECT_BENCHES_COUNTER_HPP

#include <chrono>
#include <condition_variable>
#include <mutex>

// Counts, and wakes who waits for a count once it is reached: what the waking takes is not the library's.
class Counter {
public:
    void add() {
        const auto now = std::chrono::steady_clock::now();
        bool is_reached = false;
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            is_reached = ++count_ == wanted_;
            at_ = now;
        }
        if (is_reached) {
            reached_.notify_one();
        }
    }
    long now() {
        const std::lock_guard<std::mutex> lock(mutex_);
        return count_;
    }
    // When it counted last.
    std::chrono::steady_clock::time_point at() {
        const std::lock_guard<std::mutex> lock(mutex_);
        return at_;
    }
    // Whether there were as many in time.
    bool wait(long wanted, std::chrono::milliseconds time) {
        std::unique_lock<std::mutex> lock(mutex_);
        wanted_ = wanted;
        return reached_.wait_for(lock, time, [&] { return count_ >= wanted; });
    }

private:
    std::mutex mutex_;
    std::condition_variable reached_;
    long count_ = 0;
    long wanted_ = 0;
    std::chrono::steady_clock::time_point at_;
};

#endif
