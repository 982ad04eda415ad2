/// @file
/// Records messages to MCAP files.
#ifndef RECT_RECORDER_HPP
#define RECT_RECORDER_HPP

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include "handle.hpp"
#include "text.hpp"

namespace rect {
inline namespace RECT_ABI {

/// The settings of a recording. Fields that are empty or 0 keep their defaults.
struct RecordOptions {
    /// The messages, as `<robot>/<topic>` with wildcards. Default: everything that the programs of this robot publish, and
    /// everything that they send to one robot or that is sent to this one. Messages of other robots travel over the links to this robot
    /// only because they are recorded.
    std::vector<std::string> patterns{};
    /// How much of the past to keep. Default: everything.
    std::chrono::milliseconds keep{0};
    /// The time after which the recording continues in another file. Default: never.
    std::chrono::milliseconds split{0};
    /// The size of a file in bytes at which the recording continues in another one. Default: any.
    std::uint64_t split_bytes{0};
    /// Leaves out the lines that the programs of the recorded robots log. Otherwise they are recorded, except private ones. Those of other
    /// robots travel over the links, in the background, only because they are recorded.
    bool without_logs{false};
};

/// How a recording goes.
struct RecordingProgress {
    /// Number of messages in the recording.
    std::uint64_t recorded{0};
    /// Bytes of their payloads.
    std::uint64_t bytes{0};
    /// Number of messages that were dropped, because the disk was too slow or full.
    std::uint64_t dropped{0};
    /// Why the disk does not take anything at the moment; empty if it does.
    std::string problem{};
};

/// @cond
namespace detail {

inline RecordingProgress recording_progress(const rect_recording_progress& raw) {
    return {raw.recorded, raw.bytes, raw.dropped, raw.problem};
}

}  // namespace detail
/// @endcond

/// A recording that runs: Robot::record. Without `finish`, a folder remains, which `rect recording merge` makes a file of.
///
///     auto recorder = rect::must(robot.record("match.mcap"));
///     // The match.
///     std::cout << rect::must(recorder.finish()).recorded << " messages\n";
class Recorder : public Handle {
public:
    using Handle::Handle;

    /// Returns how the recording goes. Fails with Code::closed if it was finished.
    [[nodiscard]] expected<RecordingProgress> progress() const {
        rect_recording_progress progress;
        rect_error error;
        const auto code = rect_recorder_progress({handle_id()}, &progress, &error);
        return detail::value_or_error<RecordingProgress>(code, error, [&] { return detail::recording_progress(progress); });
    }

    /// Stops, and makes one file of the recording, or several with numbers if it is split; none if nothing was recorded. Returns
    /// the final counts. Fails with Code::recording if the disk fails; the folder remains then, and can be read.
    expected<RecordingProgress> finish() {
        rect_recording_progress progress;
        rect_error error;
        const auto code = rect_recorder_finish({handle_id()}, &progress, &error);
        return detail::value_or_error<RecordingProgress>(code, error, [&] { return detail::recording_progress(progress); });
    }
};

}  // namespace RECT_ABI
}  // namespace rect

#endif
