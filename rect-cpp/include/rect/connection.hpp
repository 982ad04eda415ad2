/// @file
/// Owns who can be reached: connections of a router, and what changes about them.
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

inline std::optional<double> known(double number) {
    return std::isnan(number) ? std::nullopt : std::optional<double>(number);
}

inline std::optional<std::uint64_t> known(std::int64_t number) {
    return number < 0 ? std::nullopt : std::optional<std::uint64_t>(static_cast<std::uint64_t>(number));
}

}  // namespace detail
/// @endcond

/// How far a connection is.
enum class LinkState {
    /// There is a link.
    connected = RECT_LINK_STATE_CONNECTED,
    /// It is dialled or waited for.
    connecting = RECT_LINK_STATE_CONNECTING,
    /// The robot is in the air, and there is no link with it.
    discovered = RECT_LINK_STATE_DISCOVERED,
};

/// A connection of a robot's router (docs/registry.md).
struct Connection {
    /// Its name, if it is a named one.
    std::string name;
    /// `ble`, `tcp`, `udp`, ...
    std::string method;
    /// The other end.
    std::string address;
    /// The Zenoh id of who is there, if known.
    std::string peer_id;
    /// Which robot that is, if known.
    std::string peer;
    /// How far it is.
    LinkState state;
    /// For how long, in s.
    std::optional<double> up_s;
    /// What a small message takes there and back, in ms.
    std::optional<double> round_trip_ms;
    /// How strong its signal is, in dBm.
    std::optional<double> rssi_dbm;
    /// Bytes sent.
    std::optional<std::uint64_t> sent_bytes;
    /// Bytes received.
    std::optional<std::uint64_t> received_bytes;
    /// How often it was linked.
    std::optional<std::uint64_t> linked;
    /// How often it could not be.
    std::optional<std::uint64_t> failed;
    /// What went wrong last, if anything.
    std::string last_error;
    /// How long ago that was, in s.
    std::optional<double> last_error_ago_s;

    /// As C has it.
    explicit Connection(const rect_connection& raw)
        : name(detail::view(raw.name)),
          method(detail::view(raw.method)),
          address(detail::view(raw.address)),
          peer_id(detail::view(raw.peer_id)),
          peer(detail::view(raw.peer)),
          state(static_cast<LinkState>(raw.state)),
          up_s(detail::known(raw.up_s)),
          round_trip_ms(detail::known(raw.round_trip_ms)),
          rssi_dbm(detail::known(raw.rssi_dbm)),
          sent_bytes(detail::known(raw.sent_bytes)),
          received_bytes(detail::known(raw.received_bytes)),
          linked(detail::known(raw.linked)),
          failed(detail::known(raw.failed)),
          last_error(detail::view(raw.last_error)),
          last_error_ago_s(detail::known(raw.last_error_ago_s)) {}
};

/// A connection that a router is to have.
struct NamedConnection {
    /// Its name.
    std::string name;
    /// `ble`, `tcp`, `udp`, or any other of Zenoh's protocols.
    std::string method;
    /// For `ble` a robot's name or its Bluetooth address, else a host.
    std::string address;
    /// For methods with one.
    std::uint16_t port = 0;
    /// For `ble`: the L2CAP channel's number; 0: the advertised one.
    std::uint16_t psm = 0;
    /// Options of the method's locator, a JSON object: `{"mtu": 512}`.
    std::string options{};
};

/// A change of who can be reached, which belongs to the callback that is called with it.
class Event {
public:
    /// What has changed.
    enum class Kind {
        /// A robot of the fleet is there.
        peer_up = RECT_EVENT_KIND_PEER_UP,
        /// It is gone.
        peer_down = RECT_EVENT_KIND_PEER_DOWN,
        /// A link came up.
        link_up = RECT_EVENT_KIND_LINK_UP,
        /// It ended.
        link_down = RECT_EVENT_KIND_LINK_DOWN,
        /// This program's router is there.
        router_up = RECT_EVENT_KIND_ROUTER_UP,
        /// It is gone.
        router_down = RECT_EVENT_KIND_ROUTER_DOWN,
    };

    /// As C has it.
    explicit Event(const rect_event& raw) noexcept : raw_(raw) {}

    /// What.
    [[nodiscard]] Kind kind() const noexcept { return static_cast<Kind>(raw_.kind); }
    /// Which robot; of a link nothing, where that is not known.
    [[nodiscard]] std::string_view robot() const noexcept { return detail::view(raw_.robot); }
    /// The protocol of a link, as `ble`.
    [[nodiscard]] std::string_view method() const noexcept { return detail::view(raw_.method); }
    /// Its other end.
    [[nodiscard]] std::string_view address() const noexcept { return detail::view(raw_.address); }

private:
    rect_event raw_;
};

/// What a program has said and heard, since it joined: messages, and the bytes of their payloads.
using Counters = rect_counters;

}  // namespace RECT_ABI
}  // namespace rect

#endif
