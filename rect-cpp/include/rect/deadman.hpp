/// @file
/// Defines the dead man's switch: a robot follows commands while they arrive.
#ifndef RECT_DEADMAN_HPP
#define RECT_DEADMAN_HPP

#include <optional>
#include <string_view>
#include <type_traits>
#include <utility>

#include "callback.hpp"
#include "handle.hpp"
#include "typed.hpp"

namespace rect {
inline namespace RECT_ABI {

/// A dead man's switch. Destroying it ends it, which is a loss: when that returns, the function for the loss has been called, unless a
/// function of the switch destroys it. Then that function is called after this one has returned.
class Deadman : public Handle {
public:
    using Handle::Handle;

    /// Returns whether the robot follows commands.
    [[nodiscard]] expected<bool> is_following() const {
        bool is_following = false;
        rect_error error;
        const auto code = rect_deadman_is_following({handle_id()}, &is_following, &error);
        return detail::value_or_error<bool>(code, error, [&] { return is_following; });
    }
};

/// @cond
namespace detail {

/// The functions of a switch, which C calls. `T` is the type of the commands, or `void`.
template <class T, class C, class L>
struct DeadmanFunctions {
    using Value = std::conditional_t<std::is_void_v<T>, bool, T>;

    C on_command;
    L on_lost;
    rect_robot robot;
    /// The value of the message that is checked.
    std::optional<Value> value{};

    static bool is_command(const rect_message* raw, void* context) noexcept {
        acquire(context);
        auto& functions = *static_cast<DeadmanFunctions*>(context);
        const bool is_read = guarded([&] {
            functions.value.reset();
            if constexpr (std::is_void_v<T>) {
                functions.value = true;
            } else if (auto value = MessageOf<T>(*raw, functions.robot).value()) {
                functions.value.emplace(std::move(*value));
            }
        });
        const bool is_command = is_read && functions.value.has_value();
        release(context);
        release_all();
        return is_command;
    }

    static void call_on_command([[maybe_unused]] const rect_message* raw, void* context) noexcept {
        acquire(context);
        auto& functions = *static_cast<DeadmanFunctions*>(context);
        guarded([&] {
            if constexpr (std::is_void_v<T>) {
                functions.on_command(MessageView(*raw));
            } else {
                functions.on_command(std::as_const(*functions.value));
            }
        });
        release(context);
        release_all();
    }

    static void call_on_lost(const char* reason, void* context) noexcept {
        acquire(context);
        guarded([&] { static_cast<DeadmanFunctions*>(context)->on_lost(std::string_view(reason)); });
        release(context);
        release_all();
    }
};

}  // namespace detail
/// @endcond

}  // namespace RECT_ABI
}  // namespace rect

#endif
