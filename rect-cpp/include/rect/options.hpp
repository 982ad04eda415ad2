/// @file
/// Defines the options for connecting.
#ifndef RECT_OPTIONS_HPP
#define RECT_OPTIONS_HPP

#include <chrono>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "text.hpp"

namespace rect {
inline namespace RECT_ABI {

/// The options of rect::connect. Fields that are empty or 0 keep their defaults, which connect to the router of this
/// computer.
///
///     rect::Options options;
///     options.router = "tcp/192.168.0.7:7447";
///     const auto robot = rect::must(rect::connect("wombat-1", options));
struct Options {
    /// The team's name. Default: `rect`.
    std::string fleet{};
    /// The endpoint of the router, e.g. `tcp/192.168.0.7:7447`. Default: the value of the environment variable
    /// `RECT_ENDPOINT`, or `tcp/127.0.0.1:7447`.
    std::string router{};
    /// Endpoints to connect to directly instead of a router, e.g. `ble/wombat-2` or `udp/192.168.0.8:7447`. The program
    /// dials them until they accept; `connect` does not wait for that.
    std::vector<std::string> endpoints{};
    /// Endpoints to listen on instead of using a router, e.g. `tcp/0.0.0.0:7447` or `ble/hci0#name=wombat-1`.
    std::vector<std::string> listen{};
    /// The user to log in as, with `password`. Default: the first line of the login file.
    std::string user{};
    /// The password of the user.
    std::string password{};
    /// The file with the login as `user:password`. Default: the value of the environment variable `RECT_LOGIN`, or
    /// `/etc/rect/users`.
    std::string login_file{};
    /// How long to wait for the router. Default: 5 s, so that a program may start together with the router.
    std::chrono::milliseconds timeout{0};
    /// Settings of Zenoh as pairs of a path, e.g. `transport/unicast/max_links`, and a value in JSON. They take precedence
    /// over RECT's own settings.
    std::vector<std::pair<std::string, std::string>> zenoh{};
    /// Whether to connect even if the router belongs to another robot, for programs that deliberately use another name. The
    /// access control that `rect init` sets up drops everything that such a program publishes.
    bool allow_name_mismatch{false};
    /// The name under which this program is known in the fleet. Default: that of the executable. An empty text leaves the program
    /// without a name.
    std::optional<std::string> program{};
};

/// @cond
namespace detail {

inline std::vector<const char*> pointers(const std::vector<std::string>& texts) {
    std::vector<const char*> all;
    all.reserve(texts.size());
    for (const auto& text : texts) {
        all.push_back(text.c_str());
    }
    return all;
}

/// Calls `use` with the options as a struct of rect.h.
template <class Use>
auto with_options(const Options& options, Use use) {
    const auto endpoints = pointers(options.endpoints);
    const auto listen = pointers(options.listen);
    std::vector<const char*> keys;
    std::vector<const char*> values;
    for (const auto& [key, value] : options.zenoh) {
        keys.push_back(key.c_str());
        values.push_back(value.c_str());
    }
    rect_options raw{};
    raw.fleet = or_null(options.fleet);
    raw.router = or_null(options.router);
    raw.endpoints = endpoints.data();
    raw.endpoints_len = endpoints.size();
    raw.listen = listen.data();
    raw.listen_len = listen.size();
    raw.user = or_null(options.user);
    raw.password = options.password.c_str();
    raw.login_file = or_null(options.login_file);
    raw.program = options.program ? options.program->c_str() : nullptr;
    raw.timeout_ms = ms(options.timeout);
    raw.zenoh_keys = keys.data();
    raw.zenoh_values = values.data();
    raw.zenoh_len = keys.size();
    raw.allow_name_mismatch = options.allow_name_mismatch;
    return use(raw);
}

}  // namespace detail
/// @endcond

}  // namespace RECT_ABI
}  // namespace rect

#endif
