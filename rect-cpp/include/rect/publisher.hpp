/// @file
/// Publishes on one topic, and waits for subscribers.
#ifndef RECT_PUBLISHER_HPP
#define RECT_PUBLISHER_HPP

#include <chrono>

#include "payload.hpp"

namespace rect {
inline namespace RECT_ABI {

/// A publisher of one topic, which knows whether there are subscribers: Robot::publisher. Robot::publish needs none.
///
///     const auto angles = rect::must(robot.publisher("arm/angle"));
///     rect::must(angles.wait_for_subscriber(std::chrono::seconds(10)));
///     rect::must(angles.publish(12.5));
class Publisher : public Handle {
public:
    using Handle::Handle;

    /// Publishes a value to every subscriber. Fails like Robot::publish.
    template <class T>
    expected<void> publish(const T& value) const {
        return detail::with_payload(value, [&](const rect_payload& payload) {
            rect_error error;
            return detail::ok_or_error(rect_publisher_publish({handle_id()}, &payload, &error), error);
        });
    }

    /// Returns whether at least one subscriber of another program receives the messages, on this or another robot.
    [[nodiscard]] expected<bool> has_subscribers() const {
        bool has_subscribers = false;
        rect_error error;
        const auto code = rect_publisher_has_subscribers({handle_id()}, &has_subscribers, &error);
        return detail::value_or_error<bool>(code, error, [&] { return has_subscribers; });
    }

    /// Waits until a subscriber receives the messages. Fails with Code::timed_out if there is none within `timeout`, and with
    /// Code::closed if the session was closed or another thread dropped this publisher.
    expected<void> wait_for_subscriber(std::chrono::milliseconds timeout = forever) const {
        rect_error error;
        return detail::ok_or_error(rect_publisher_wait_for_subscriber({handle_id()}, detail::ms(timeout), &error), error);
    }
};

}  // namespace RECT_ABI
}  // namespace rect

#endif
