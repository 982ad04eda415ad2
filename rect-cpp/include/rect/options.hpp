/// @file
/// Owns how a program joins.
#ifndef RECT_OPTIONS_HPP
#define RECT_OPTIONS_HPP

#include <chrono>
#include <string>
#include <utility>
#include <vector>

#include "text.hpp"

namespace rect {
inline namespace RECT_ABI {

/// How to join, where `connect("wombat-1")` does not do. What is empty or 0 is left at its default.
struct Options {
    /// The team's name; default `rect`.
    std::string fleet{};
    /// The router, as `tcp/192.168.0.7:7447`; default: what the environment's `RECT_ENDPOINT` says, else
    /// `tcp/127.0.0.1:7447`.
    std::string router{};
    /// Without a router: connects to these directly, as `ble/wombat-2` or `udp/192.168.0.8:7447`. They are dialled until they
    /// are there; joining does not wait for them.
    std::vector<std::string> endpoints{};
    /// Without a router: others may connect to this program there, as `tcp/0.0.0.0:7447` or `ble/hci0#name=wombat-1`.
    std::vector<std::string> listen{};
    /// As that user; default: the first line of the login file.
    std::string user{};
    /// The user's password.
    std::string password{};
    /// The file with the login, `user:password`; default: what the environment's `RECT_LOGIN` says, else `/etc/rect/users`.
    std::string login_file{};
    /// How long to wait for the router; default 5 s, so that a program may be started together with it.
    std::chrono::milliseconds patience{0};
    /// Any settings of Zenoh's configuration: paths, as `transport/unicast/max_links`, and their values in JSON.
    std::vector<std::pair<std::string, std::string>> zenoh{};
    /// Joins although the router serves another robot: for a program that uses another name on purpose. A router with access
    /// control as `rect-router init` writes it drops what such a program publishes.
    bool allow_name_mismatch{false};
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

/// Calls `use` with the options as C wants them.
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
    raw.patience_ms = ms(options.patience);
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
