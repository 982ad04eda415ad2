/// @file
/// Defines the stop of a fleet.
#ifndef RECT_STOP_HPP
#define RECT_STOP_HPP

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include "handle.hpp"
#include "span.hpp"
#include "text.hpp"

namespace rect {
inline namespace RECT_ABI {

/// A stop that nobody has released.
struct Stop {
    /// The program that pressed it: `<robot>/<program>`.
    std::string by;
    /// Why, in that program's words; empty if it did not say.
    std::string reason;
    /// The stop in words: `stopped by laptop/page: smoke`.
    std::string in_words;
    /// When, by the clock of that robot.
    std::chrono::system_clock::time_point at;
};

/// How far a robot has followed the stop or its release.
enum class Confirmation : std::uint32_t {
    /// None of its programs takes part, or it is not reachable.
    none = RECT_CONFIRMATION_NONE,
    /// It knows all stops and releases that this program knows.
    confirmed = RECT_CONFIRMATION_CONFIRMED,
    /// Its program takes part, and has not confirmed.
    waiting = RECT_CONFIRMATION_WAITING,
    /// The program of the robot that took part has ended.
    ended = RECT_CONFIRMATION_ENDED,
};

/// The stop of the fleet. While a program has one, its robot takes part: it remembers stops, passes them on, and confirms them.
///
///     const auto stop = rect::must(robot.fleet_stop());
///     rect::must(stop.press("smoke"));
class FleetStop : public Handle {
public:
    using Handle::Handle;

    /// Stops the fleet, until somebody releases it. `reason`: why, in a few words, for people. Returns when the router of this robot has
    /// the stop; `confirmation` says which robots have it. Fails with Code::not_retained if no router keeps it: only robots that are
    /// reachable now get it.
    expected<void> press(const Text& reason = "") const {
        if (reason.c_str() == nullptr) {
            return detail::failed(Code::argument, "the argument reason contains a zero byte");
        }
        rect_error error;
        return detail::ok_or_error(rect_fleet_stop_press(raw(), reason.c_str(), &error), error);
    }

    /// Releases all stops that this robot knows. Nothing moves yet: Robot::deadman waits for a neutral command. Nothing happens if there
    /// is none. Fails like `press`.
    expected<void> release() const {
        rect_error error;
        return detail::ok_or_error(rect_fleet_stop_release(raw(), &error), error);
    }

    /// Returns whether the fleet is stopped.
    [[nodiscard]] expected<bool> is_stopped() const {
        bool is_stopped = false;
        rect_error error;
        const auto code = rect_fleet_stop_is_stopped(raw(), &is_stopped, &error);
        return detail::value_or_error<bool>(code, error, [&] { return is_stopped; });
    }

    /// Returns the stops that nobody has released, the latest first.
    [[nodiscard]] expected<std::vector<Stop>> pressed() const {
        rect_stops stops;
        rect_error error;
        const auto code = rect_fleet_stop_pressed(raw(), &stops, &error);
        return detail::value_or_error<std::vector<Stop>>(code, error, [&] {
            const Handle handle(stops.id);
            std::vector<Stop> all;
            for (const auto& stop : span<const rect_stop>(stops.items, stops.len)) {
                const std::chrono::system_clock::time_point at{std::chrono::milliseconds(stop.at_ms)};
                all.push_back({std::string(detail::view(stop.by)), std::string(detail::view(stop.reason)),
                               std::string(detail::view(stop.in_words)), at});
            }
            return all;
        });
    }

    /// Returns whether a robot has confirmed the stop, or its release. Fails with Code::name if the name is invalid.
    [[nodiscard]] expected<Confirmation> confirmation(const Text& robot) const {
        std::uint32_t confirmation = RECT_CONFIRMATION_NONE;
        rect_error error;
        const auto code = rect_fleet_stop_confirmation(raw(), robot.c_str(), &confirmation, &error);
        return detail::value_or_error<Confirmation>(code, error, [&] { return static_cast<Confirmation>(confirmation); });
    }

    /// Waits for a stop, a release or a confirmation that was not known when this was called last, or when the object was created.
    /// Several are reported as one. Fails with Code::timed_out if there is none within `timeout`, and with Code::closed if the session was
    /// closed or another thread dropped this object.
    expected<void> wait_for_change(std::chrono::milliseconds timeout = forever) const {
        rect_error error;
        return detail::ok_or_error(rect_fleet_stop_wait_for_change(raw(), detail::ms(timeout), &error), error);
    }

private:
    [[nodiscard]] rect_fleet_stop raw() const noexcept { return {handle_id()}; }
};

}  // namespace RECT_ABI
}  // namespace rect

#endif
