// Something that is counted on one thread and waited for on another.
#ifndef RECT_BENCHES_COUNTER_HPP
#define RECT_BENCHES_COUNTER_HPP

#include <chrono>
#include <condition_variable>
#include <mutex>

// Counts, and wakes who waits for a count.
class Counter {
public:
    void add() {
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            ++count_;
        }
        changed_.notify_one();
    }
    long now() {
        const std::lock_guard<std::mutex> lock(mutex_);
        return count_;
    }
    // Whether there were as many in time.
    bool wait(long wanted, std::chrono::milliseconds time) {
        std::unique_lock<std::mutex> lock(mutex_);
        return changed_.wait_for(lock, time, [&] { return count_ >= wanted; });
    }

private:
    std::mutex mutex_;
    std::condition_variable changed_;
    long count_ = 0;
};

#endif
