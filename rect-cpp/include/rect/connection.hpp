/// @file
/// Describes the connections of a router, and events about robots, links and the router.
#ifndef RECT_CONNECTION_HPP
#define RECT_CONNECTION_HPP

#include <cmath>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "text.hpp"

namespace rect {
inline namespace RECT_ABI {

/// @cond
namespace detail {

inline std::optional<double> value_if_known(double number) {
    return std::isnan(number) ? std::nullopt : std::optional<double>(number);
}

inline std::optional<std::uint64_t> value_if_known(std::int64_t number) {
    return number < 0 ? std::nullopt : std::optional<std::uint64_t>(static_cast<std::uint64_t>(number));
}

}  // namespace detail
/// @endcond

/// The state of a connection.
enum class ConnectionState {
    /// There is a link.
    connected = RECT_CONNECTION_STATE_CONNECTED,
    /// The router dials the peer, or waits for it to dial.
    connecting = RECT_CONNECTION_STATE_CONNECTING,
    /// An advertisement of the robot was received; there is no link to it.
    discovered = RECT_CONNECTION_STATE_DISCOVERED,
};

/// A connection of a robot's router (docs/reference/registry.md). Unknown values are empty.
struct Connection {
    /// The name of a named connection; otherwise empty.
    std::string name;
    /// The method of the link: `any`, `ble`, `tcp`, `udp` and so on.
    std::string method;
    /// The address of the other end.
    std::string address;
    /// The Zenoh id of the peer; empty if it is not known.
    std::string peer_id;
    /// The name of the peer's robot; empty if it is not known.
    std::string peer;
    /// The state.
    ConnectionState state;
    /// Time since the link was established, in seconds.
    std::optional<double> up_s;
    /// Round-trip time of a small message, in milliseconds.
    std::optional<double> round_trip_ms;
    /// Received signal strength, in dBm.
    std::optional<double> rssi_dbm;
    /// Whether the link is encrypted.
    std::optional<bool> encrypted;
    /// For the method `any`, the method of the path that carries the bulk: `ble` or `tcp`. Otherwise empty.
    std::string path;
    /// For the method `any`, how often that path has changed.
    std::optional<std::uint64_t> switches;
    /// Why it has changed last: `ended`, `silent` or `faster`. Empty if it has not.
    std::string last_switch_reason;
    /// How long data had waited when another path took it over, in milliseconds.
    std::optional<double> last_switch_gap_ms;
    /// Time since that change, in seconds.
    std::optional<double> last_switch_ago_s;
    /// Number of bytes that wait to be sent, for the methods `any` and `ble`.
    std::optional<std::uint64_t> waiting_bytes;
    /// Time until the peer has acknowledged an urgent message, in milliseconds, for these methods.
    std::optional<double> urgent_delay_ms;
    /// Number of batches that were not sent because Zenoh dropped their message, for these methods.
    std::optional<std::uint64_t> dropped_batches;
    /// Number of bytes sent.
    std::optional<std::uint64_t> sent_bytes;
    /// Number of bytes received.
    std::optional<std::uint64_t> received_bytes;
    /// How many times a link was established.
    std::optional<std::uint64_t> linked;
    /// How many attempts to establish a link failed.
    std::optional<std::uint64_t> failed;
    /// The last error; empty if there was none.
    std::string last_error;
    /// Time since the last error, in seconds.
    std::optional<double> last_error_ago_s;

    /// Copies a struct of rect.h.
    explicit Connection(const rect_connection& raw)
        : name(detail::view(raw.name)),
          method(detail::view(raw.method)),
          address(detail::view(raw.address)),
          peer_id(detail::view(raw.peer_id)),
          peer(detail::view(raw.peer)),
          state(static_cast<ConnectionState>(raw.state)),
          up_s(detail::value_if_known(raw.up_s)),
          round_trip_ms(detail::value_if_known(raw.round_trip_ms)),
          rssi_dbm(detail::value_if_known(raw.rssi_dbm)),
          encrypted(raw.encrypted < 0 ? std::nullopt : std::optional<bool>(raw.encrypted != 0)),
          path(detail::view(raw.path)),
          switches(detail::value_if_known(raw.switches)),
          last_switch_reason(detail::view(raw.last_switch_reason)),
          last_switch_gap_ms(detail::value_if_known(raw.last_switch_gap_ms)),
          last_switch_ago_s(detail::value_if_known(raw.last_switch_ago_s)),
          waiting_bytes(detail::value_if_known(raw.waiting_bytes)),
          urgent_delay_ms(detail::value_if_known(raw.urgent_delay_ms)),
          dropped_batches(detail::value_if_known(raw.dropped_batches)),
          sent_bytes(detail::value_if_known(raw.sent_bytes)),
          received_bytes(detail::value_if_known(raw.received_bytes)),
          linked(detail::value_if_known(raw.linked)),
          failed(detail::value_if_known(raw.failed)),
          last_error(detail::view(raw.last_error)),
          last_error_ago_s(detail::value_if_known(raw.last_error_ago_s)) {}
};

/// A named connection to add to a router with Robot::add_connection. `name`, `method` and `address` are required.
struct NamedConnection {
    /// The name of the connection.
    std::string name;
    /// The method: `any`, `ble`, `tcp`, `udp` or another protocol of Zenoh.
    std::string method;
    /// For `any` and `ble`, the name or Bluetooth address of a robot; for other methods, a host.
    std::string address;
    /// The port, for methods that have ports. 0 means none.
    std::uint16_t port = 0;
    /// The L2CAP PSM, for `ble`. If 0, the advertised PSM is used.
    std::uint16_t psm = 0;
    /// Options of the locator as a JSON object, e.g. `{"mtu": 512}`.
    std::string options{};
};

/// A change of a robot, a link or the router. It is valid until the callback that receives it returns.
class Event {
public:
    /// The kind of an event.
    enum class Kind {
        /// A robot of the fleet became reachable.
        peer_up = RECT_EVENT_KIND_PEER_UP,
        /// A robot of the fleet became unreachable.
        peer_down = RECT_EVENT_KIND_PEER_DOWN,
        /// A link was established.
        link_up = RECT_EVENT_KIND_LINK_UP,
        /// A link ended.
        link_down = RECT_EVENT_KIND_LINK_DOWN,
        /// The router of this program became reachable.
        router_up = RECT_EVENT_KIND_ROUTER_UP,
        /// The router of this program became unreachable.
        router_down = RECT_EVENT_KIND_ROUTER_DOWN,
        /// Another path carries the bulk of a link whose method is `any`.
        path_switched = RECT_EVENT_KIND_PATH_SWITCHED,
        /// A program that has a name is known at a robot.
        program_up = RECT_EVENT_KIND_PROGRAM_UP,
        /// A program has ended, or its robot became unreachable.
        program_down = RECT_EVENT_KIND_PROGRAM_DOWN,
        /// Nothing has been received over a link for longer than usual. It may end, or resume.
        link_silent = RECT_EVENT_KIND_LINK_SILENT,
        /// Something has been received over a link that was silent.
        link_resumed = RECT_EVENT_KIND_LINK_RESUMED,
    };

    /// Refers to a struct of rect.h.
    explicit Event(const rect_event& raw) noexcept : raw_(raw) {}

    /// Returns the kind of the event.
    [[nodiscard]] Kind kind() const noexcept { return static_cast<Kind>(raw_.kind); }
    /// Returns the robot concerned. Empty for router events, and for a link whose other end is not known.
    [[nodiscard]] std::string_view robot() const noexcept { return detail::view(raw_.robot); }
    /// Returns the method of the link, e.g. `ble`. Empty if the event does not concern a link.
    [[nodiscard]] std::string_view method() const noexcept { return detail::view(raw_.method); }
    /// Returns the address of the link's other end. Empty if the event does not concern a link.
    [[nodiscard]] std::string_view address() const noexcept { return detail::view(raw_.address); }
    /// Returns the method of the path that carries the bulk now, `ble` or `tcp`. Empty unless the path has changed.
    [[nodiscard]] std::string_view path() const noexcept { return detail::view(raw_.path); }
    /// Returns why the path has changed: `ended`, `silent` or `faster`. Empty unless it has.
    [[nodiscard]] std::string_view reason() const noexcept { return detail::view(raw_.reason); }
    /// Returns the name of the program. Empty if the event does not concern one.
    [[nodiscard]] std::string_view program() const noexcept { return detail::view(raw_.program); }

private:
    rect_event raw_;
};

/// Counts of the messages of a program since it connected.
using Counters = rect_counters;

}  // namespace RECT_ABI
}  // namespace rect

#endif
