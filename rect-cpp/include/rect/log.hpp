/// @file
/// Defines the lines of logs, and how logs are read.
#ifndef RECT_LOG_HPP
#define RECT_LOG_HPP

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "handle.hpp"
#include "span.hpp"
#include "text.hpp"

namespace rect {
inline namespace RECT_ABI {

/// How important a line of a log, or an alert, is.
enum class Level : std::uint32_t {
    /// Details for finding a fault in the program.
    debug = RECT_LEVEL_DEBUG,
    /// The usual course of the program.
    info = RECT_LEVEL_INFO,
    /// Something that somebody should look at.
    warn = RECT_LEVEL_WARN,
    /// Something has failed.
    error = RECT_LEVEL_ERROR,
};

/// A line for Robot::log_line, with everything that belongs to it.
///
///     rect::LogLine line{rect::Level::warn, "the gripper is slow"};
///     line.fields = R"({"angle": 12.5})";
///     robot.log_line(line);
struct LogLine {
    /// How important it is.
    Level level{Level::info};
    /// The text, of 8 kB at most; a longer one is cut. It may have several lines, such as those of a stack trace.
    std::string text{};
    /// The part of the program that logs it, such as `arm`; may be empty.
    std::string logger{};
    /// Values with names, as a JSON object such as `{"angle": 12.5}`; may be empty. Any other text becomes a field named `fields`.
    std::string fields{};
    /// The file of the source code, whose folders are left out. Default: that of the call.
    std::string file{};
    /// The line in that file.
    int line{0};
    /// Whether it stays on this robot: access control does not let other robots read it. For what may contain paths or passwords.
    bool is_private{false};
};

/// Which lines Robot::logs reads. Default: the last 100 lines of all programs and levels.
struct LogOptions {
    /// The program; empty: all programs.
    std::string program{};
    /// The least important level.
    Level level{Level::debug};
    /// The maximum number of lines of each robot that were logged before, 10,000 at most.
    std::size_t last{100};
    /// Whether new lines follow, until the Logs object is destroyed. They cross the link, in the background, while somebody follows.
    bool follow{false};
    /// How long the router of a robot may take to answer.
    std::chrono::milliseconds timeout{default_timeout};
};

/// A line that a router keeps.
struct KeptLine {
    /// Its number at this run of the router, beginning with 1.
    std::uint64_t number;
    /// The program; `unnamed` if it has no name.
    std::string program;
    /// When it was logged, by the clock of its robot.
    std::chrono::system_clock::time_point at;
    /// How important it is.
    Level level;
    /// The part of the program; `stdout` or `stderr` for its output, otherwise possibly empty.
    std::string logger;
    /// The text, which may have several lines.
    std::string text;
    /// Values with names, as a JSON object; empty if there are none.
    std::string fields;
    /// The place in the source code, such as `arm.cpp:12`; possibly empty.
    std::string source;
};

/// Lines of a log, or news of the reading, from Logs::next.
struct LogItem {
    /// The kind of an item.
    enum class Kind {
        /// Lines of a robot, or the fact that it has answered and has none.
        lines = RECT_LOG_ITEM_KIND_LINES,
        /// All routers have answered that can be reached: the lines that follow are new.
        complete = RECT_LOG_ITEM_KIND_COMPLETE,
        /// New lines of a robot were missed, because its program logged faster than the link carries.
        missed = RECT_LOG_ITEM_KIND_MISSED,
    };

    /// The kind.
    Kind kind;
    /// The robot; empty for Kind::complete.
    std::string robot;
    /// The lines in the order in which they were logged.
    std::vector<KeptLine> lines;
    /// Whether the lines are newer than all lines of that robot before. Otherwise they are older: the last lines arrive in parts, newest
    /// ones first.
    bool is_new;
};

/// @cond
namespace detail {

/// Returns a time in milliseconds since 1970, of any robot's clock. One that is too far ahead becomes the latest possible one.
inline std::chrono::system_clock::time_point time(std::uint64_t ms) {
    using std::chrono::milliseconds;
    using Clock = std::chrono::system_clock;
    constexpr auto latest = std::chrono::duration_cast<milliseconds>(Clock::duration::max()).count();
    return Clock::time_point(milliseconds(static_cast<milliseconds::rep>(std::min(ms, static_cast<std::uint64_t>(latest)))));
}

/// Returns a text for C. A zero byte would end it early.
inline std::string without_zeros(std::string text) {
    std::replace(text.begin(), text.end(), '\0', ' ');
    return text;
}

/// Logs a line. There is nothing to do about a robot that was moved from or dropped.
inline void log(rect_robot robot, const LogLine& line, const char* file, int number) {
    const auto text = without_zeros(line.text);
    const auto logger = without_zeros(line.logger);
    const auto fields = without_zeros(line.fields);
    rect_log_line raw{};
    raw.level = static_cast<std::uint32_t>(line.level);
    raw.text = text.c_str();
    raw.logger = logger.c_str();
    raw.fields = fields.c_str();
    raw.file = line.file.empty() ? file : line.file.c_str();
    raw.line = static_cast<std::uint32_t>(std::max(0, line.file.empty() ? number : line.line));
    raw.is_private = line.is_private;
    (void)rect_robot_log_line(robot, &raw);
}

}  // namespace detail
/// @endcond

/// The logs that a program reads, created by Robot::logs. Destroying it ends that.
///
///     const auto logs = rect::must(robot.logs("wombat-2"));
///     while (const auto item = logs.next()) {
///         for (const auto& line : item->lines) {
///             std::cout << line.text << std::endl;
///         }
///     }
class Logs : public Handle {
public:
    using Handle::Handle;

    /// Waits for the next lines. Fails with Code::end when all routers have answered, unless new lines follow, or if the session was
    /// closed; with Code::timed_out if nothing arrives within `timeout`; and with Code::closed if another thread dropped this object.
    [[nodiscard]] expected<LogItem> next(std::chrono::milliseconds timeout = forever) const {
        rect_log_item item;
        rect_error error;
        const auto code = rect_logs_next({handle_id()}, detail::ms(timeout), &item, &error);
        return detail::value_or_error<LogItem>(code, error, [&] {
            const Handle handle(item.id);
            LogItem copy{static_cast<LogItem::Kind>(item.kind), std::string(detail::view(item.robot)), {}, item.is_new};
            for (const auto& line : span<const rect_kept_line>(item.lines, item.len)) {
                copy.lines.push_back({line.number, std::string(detail::view(line.program)), detail::time(line.at_ms),
                                      static_cast<Level>(line.level), std::string(detail::view(line.logger)),
                                      std::string(detail::view(line.text)), std::string(detail::view(line.fields)),
                                      std::string(detail::view(line.source))});
            }
            return copy;
        });
    }
};

}  // namespace RECT_ABI
}  // namespace rect

#endif
