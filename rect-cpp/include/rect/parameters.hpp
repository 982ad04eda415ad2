/// @file
/// Defines groups of parameters, which people tune while the program runs.
#ifndef RECT_PARAMETERS_HPP
#define RECT_PARAMETERS_HPP

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include "callback.hpp"
#include "handle.hpp"
#include "options.hpp"
#include "service.hpp"
#include "span.hpp"

namespace rect {
inline namespace RECT_ABI {

/// The value of a parameter: a bool, an integer, a number, a text, or a list of numbers. The choice from a list is a text.
class ParameterValue {
public:
    /// The types of values.
    using Variant = std::variant<bool, std::int64_t, double, std::string, std::vector<double>>;

    /// Takes a bool, an integer or a number.
    template <class T, class = std::enable_if_t<std::is_arithmetic_v<T>>>
    ParameterValue(T value) : value_(of(value)) {}
    /// Copies a text.
    ParameterValue(const char* text) : value_(std::string(text)) {}
    /// Copies a text.
    ParameterValue(std::string_view text) : value_(std::string(text)) {}
    /// Takes a text.
    ParameterValue(std::string text) : value_(std::move(text)) {}
    /// Takes a list of numbers.
    ParameterValue(std::vector<double> numbers) : value_(std::move(numbers)) {}

    /// Returns the value as a `std::variant`.
    [[nodiscard]] const Variant& variant() const noexcept { return value_; }
    /// Returns the bool. Throws `std::bad_variant_access` if it is something else.
    [[nodiscard]] bool boolean() const { return std::get<bool>(value_); }
    /// Returns the integer. Throws `std::bad_variant_access` if it is something else.
    [[nodiscard]] std::int64_t integer() const { return std::get<std::int64_t>(value_); }
    /// Returns the number, which may be an integer. Throws `std::bad_variant_access` if it is something else.
    [[nodiscard]] double number() const {
        const auto* integer = std::get_if<std::int64_t>(&value_);
        return integer != nullptr ? static_cast<double>(*integer) : std::get<double>(value_);
    }
    /// Returns the text. Throws `std::bad_variant_access` if it is something else.
    [[nodiscard]] const std::string& text() const { return std::get<std::string>(value_); }
    /// Returns the list of numbers. Throws `std::bad_variant_access` if it is something else.
    [[nodiscard]] const std::vector<double>& numbers() const { return std::get<std::vector<double>>(value_); }

    /// Returns whether two values have the same type and are equal.
    friend bool operator==(const ParameterValue& one, const ParameterValue& other) { return one.value_ == other.value_; }
    /// Returns whether two values have another type or are not equal.
    friend bool operator!=(const ParameterValue& one, const ParameterValue& other) { return !(one == other); }

private:
    template <class T>
    static Variant of(T value) {
        if constexpr (std::is_same_v<T, bool>) {
            return value;
        } else if constexpr (std::is_floating_point_v<T>) {
            return static_cast<double>(value);
        } else if constexpr (std::is_signed_v<T>) {
            return static_cast<std::int64_t>(value);
        } else {
            constexpr std::uint64_t max = std::numeric_limits<std::int64_t>::max();
            return static_cast<std::int64_t>(std::min<std::uint64_t>(value, max));
        }
    }

    Variant value_;
};

/// Values of parameters, by their names: `{{"kp", 2.0}, {"side", "left"}}`.
using ParameterValues = std::map<std::string, ParameterValue>;

/// A parameter that has another value now.
struct ChangedParameter {
    /// The name.
    std::string name;
    /// The value before.
    ParameterValue before;
    /// The value now.
    ParameterValue after;
};

/// A change of parameters. Those that are changed together are one change.
struct ParameterChange {
    /// The parameters that have another value now.
    std::vector<ChangedParameter> changed;
    /// The program that has changed them, `<robot>/<program>` or `<robot>`; empty if it was this program.
    std::string by;
};

/// The options of a group of parameters, which are the members of the struct `T`.
///
/// The functions are called on the thread that calls ParameterGroup::set, and on a thread of the session for the changes of others. They
/// may use all of RECT, and must not take long: the next change waits.
template <class T>
struct ParameterOptions {
    /// The purpose of the group: at most 200 characters.
    std::string about{};
    /// The file in which the values are kept. Default: `<folder>/<robot>/<group>.json`, in the folder of the environment variable
    /// `RECT_PARAMETERS`, or `~/.local/state/rect/parameters`.
    std::string file{};
    /// Whether the program begins with the defaults at each start: the values are kept in no file.
    bool without_file{false};
    /// Called with the values as they would be before each change. It refuses the change by throwing a Refusal with the reason. It must
    /// not change parameters. An exception of another kind refuses the change as well, and is passed to the function of
    /// rect::on_callback_error.
    std::function<void(const T&)> check{};
    /// Called with the new values and what has changed after each change, for one change at a time and in order.
    std::function<void(const T&, const ParameterChange&)> on_change{};
};

/// A parameter that a program of some robot has declared.
struct DeclaredParameter {
    /// The name of the group.
    std::string group;
    /// The name of the program; empty if the program has none.
    std::string program;
    /// The name.
    std::string name;
    /// The default. The values in force are the retained topic `parameters/<group>` of the robot.
    ParameterValue default_value;
    /// The smallest number; nothing: any.
    std::optional<double> min;
    /// The largest number; nothing: any.
    std::optional<double> max;
    /// The choices; empty if it is not a choice.
    std::vector<std::string> choices;
    /// The unit, such as `m/s`; empty if there is none.
    std::string unit;
    /// Its purpose, in the words of the program; empty if there are none.
    std::string about;
    /// Whether only the program itself changes it.
    bool read_only;
};

/// How to change the parameters of another program.
struct SetOptions {
    /// Whether to wait until the values are stored, which takes up to a second longer. Otherwise, a power cut within that second may
    /// lose them.
    bool stored{false};
    /// How long to wait for the reply.
    std::chrono::milliseconds timeout{default_timeout};
};

/// @cond
namespace detail {

constexpr double no_limit = std::numeric_limits<double>::quiet_NaN();

inline ParameterValue parameter_value(const rect_parameter_value& raw) {
    switch (static_cast<rect_parameter_type>(raw.kind)) {
        case RECT_PARAMETER_TYPE_BOOL: return raw.boolean;
        case RECT_PARAMETER_TYPE_INTEGER: return raw.integer;
        case RECT_PARAMETER_TYPE_NUMBER: return raw.number;
        case RECT_PARAMETER_TYPE_TEXT: return view(raw.text);
        case RECT_PARAMETER_TYPE_NUMBERS: break;
    }
    const span<const double> numbers(raw.numbers, raw.numbers_len);
    return std::vector<double>(numbers.begin(), numbers.end());
}

/// Returns values for C, which point to `values`.
inline std::vector<rect_parameter_value> raw(const ParameterValues& values) {
    std::vector<rect_parameter_value> all;
    all.reserve(values.size());
    for (const auto& [name, value] : values) {
        auto& raw_value = all.emplace_back();
        raw_value = {};
        raw_value.name = raw(name);
        raw_value.kind = static_cast<std::uint32_t>(value.variant().index());
        if (const auto* boolean = std::get_if<bool>(&value.variant())) {
            raw_value.boolean = *boolean;
        } else if (const auto* integer = std::get_if<std::int64_t>(&value.variant())) {
            raw_value.integer = *integer;
        } else if (const auto* number = std::get_if<double>(&value.variant())) {
            raw_value.number = *number;
        } else if (const auto* text = std::get_if<std::string>(&value.variant())) {
            raw_value.text = raw(*text);
        } else {
            raw_value.numbers = value.numbers().data();
            raw_value.numbers_len = value.numbers().size();
        }
    }
    return all;
}

static_assert(RECT_PARAMETER_TYPE_BOOL == 0 && RECT_PARAMETER_TYPE_INTEGER == 1 && RECT_PARAMETER_TYPE_NUMBER == 2 &&
                  RECT_PARAMETER_TYPE_TEXT == 3 && RECT_PARAMETER_TYPE_NUMBERS == 4,
              "the types have the order of ParameterValue::Variant");

inline ParameterValues parameter_values(const rect_parameter_values& raw) {
    ParameterValues values;
    for (const auto& value : span<const rect_parameter_value>(raw.items, raw.len)) {
        values.emplace(view(value.name), parameter_value(value));
    }
    return values;
}

inline DeclaredParameter declared_parameter(const rect_declared_parameter& raw) {
    DeclaredParameter parameter{std::string(view(raw.group)),
                                std::string(view(raw.program)),
                                std::string(view(raw.default_value.name)),
                                parameter_value(raw.default_value),
                                {},
                                {},
                                {},
                                std::string(view(raw.unit)),
                                std::string(view(raw.about)),
                                raw.read_only};
    if (!std::isnan(raw.min)) {
        parameter.min = raw.min;
    }
    if (!std::isnan(raw.max)) {
        parameter.max = raw.max;
    }
    for (const auto& choice : span<const rect_text>(raw.choices, raw.choices_len)) {
        parameter.choices.emplace_back(view(choice));
    }
    return parameter;
}

inline ParameterChange parameter_change(const rect_parameter_change& raw) {
    ParameterChange change{{}, std::string(view(raw.by))};
    for (const auto& changed : span<const rect_changed_parameter>(raw.changed, raw.changed_len)) {
        const auto& after = changed.after;
        change.changed.push_back({std::string(view(after.name)), parameter_value(changed.before), parameter_value(after)});
    }
    return change;
}

/// A member of a struct that is a parameter.
template <class T>
struct Field {
    std::string name;
    ParameterValue default_value;
    double min;
    double max;
    std::function<void(T&, const rect_parameter_value&)> read;
    std::vector<std::string> choices{};
    std::string unit{};
    std::string about{};
    bool is_read_only{false};

    /// Adds it to a declaration of rect.h.
    rect_code add(rect_parameters parameters, rect_error* error) const {
        const Text text(name);
        const auto* raw_name = text.c_str();
        const auto* raw_unit = unit.c_str();
        const auto* raw_about = about.c_str();
        auto code = RECT_CODE_OK;
        const auto& value = default_value.variant();
        if (const auto* boolean = std::get_if<bool>(&value)) {
            code = rect_parameters_add_bool(parameters, raw_name, *boolean, raw_about, error);
        } else if (const auto* integer = std::get_if<std::int64_t>(&value)) {
            code = rect_parameters_add_integer(parameters, raw_name, *integer, min, max, raw_unit, raw_about, error);
        } else if (const auto* number = std::get_if<double>(&value)) {
            code = rect_parameters_add_number(parameters, raw_name, *number, min, max, raw_unit, raw_about, error);
        } else if (const auto* numbers = std::get_if<std::vector<double>>(&value)) {
            code = rect_parameters_add_numbers(parameters, raw_name, numbers->data(), numbers->size(), min, max, raw_unit,
                                               raw_about, error);
        } else if (const Text default_text(default_value.text()); choices.empty()) {
            code = rect_parameters_add_text(parameters, raw_name, default_text.c_str(), raw_about, error);
        } else {
            const auto all = pointers(choices);
            code = rect_parameters_add_choice(parameters, raw_name, default_text.c_str(), all.data(), all.size(), raw_about,
                                              error);
        }
        if (code == RECT_CODE_OK && is_read_only) {
            code = rect_parameters_make_read_only(parameters, raw_name, error);
        }
        return code;
    }
};

}  // namespace detail
/// @endcond

/// The members of the struct `T` that are parameters; rect::fields creates it. `range`, `min`, `max`, `unit`, `choices`, `about` and
/// `read_only` describe the member that was added last.
template <class T>
class Fields {
public:
    /// Adds a member: a `bool`, an integer, a number, a `std::string` or a `std::vector<double>`. Its default is the value in `T{}`.
    template <class M, class C>
    Fields& field(std::string name, M C::*member) {
        static_assert(std::is_base_of_v<C, T>, "the member belongs to another struct");
        static_assert(std::is_arithmetic_v<M> || std::is_same_v<M, std::string> || std::is_same_v<M, std::vector<double>>,
                      "a parameter is a bool, an integer, a number, a std::string or a std::vector<double>");
        const auto limits = type_limits<M>();
        const auto read = [member](T& to, const rect_parameter_value& value) {
            if constexpr (std::is_same_v<M, bool>) {
                to.*member = value.boolean;
            } else if constexpr (std::is_integral_v<M>) {
                to.*member = static_cast<M>(value.integer);
            } else if constexpr (std::is_floating_point_v<M>) {
                to.*member = static_cast<M>(value.number);
            } else if constexpr (std::is_same_v<M, std::string>) {
                to.*member = detail::view(value.text);
            } else {
                const span<const double> numbers(value.numbers, value.numbers_len);
                (to.*member).assign(numbers.begin(), numbers.end());
            }
        };
        fields_.push_back({std::move(name), T{}.*member, limits.first, limits.second, read});
        return *this;
    }

    /// Sets the smallest and the largest value of a number, an integer, or each number of a list.
    Fields& range(double min, double max) { return this->min(min).max(max); }
    /// Sets the smallest value. Default: any.
    Fields& min(double min) {
        auto& field = last();
        field.min = std::fmax(field.min, min);
        return *this;
    }
    /// Sets the largest value. Default: any.
    Fields& max(double max) {
        auto& field = last();
        field.max = std::fmin(field.max, max);
        return *this;
    }
    /// Sets the unit, such as `m/s`.
    Fields& unit(std::string unit) {
        last().unit = std::move(unit);
        return *this;
    }
    /// Makes a text the choice from a list.
    Fields& choices(std::vector<std::string> choices) {
        last().choices = std::move(choices);
        return *this;
    }
    /// Sets the description: at most 200 characters.
    Fields& about(std::string about) {
        last().about = std::move(about);
        return *this;
    }
    /// Lets only the program itself change it.
    Fields& read_only() {
        last().is_read_only = true;
        return *this;
    }

    /// @cond
    [[nodiscard]] const std::vector<detail::Field<T>>& all() const noexcept { return fields_; }
    /// @endcond

private:
    detail::Field<T>& last() {
        if (fields_.empty()) {
            throw std::logic_error("rect::Fields: call field() before the functions that describe a field");
        }
        return fields_.back();
    }

    // The limits that an integer has because of its type.
    template <class M>
    static std::pair<double, double> type_limits() {
        if constexpr (std::is_integral_v<M> && !std::is_same_v<M, bool>) {
            using Limits = std::numeric_limits<M>;
            const bool is_long = sizeof(M) == sizeof(std::int64_t);
            const auto min = static_cast<double>(Limits::lowest());
            const auto max = static_cast<double>(Limits::max());
            return {is_long && std::is_signed_v<M> ? detail::no_limit : min, is_long ? detail::no_limit : max};
        } else {
            return {detail::no_limit, detail::no_limit};
        }
    }

    std::vector<detail::Field<T>> fields_;
};

/// Begins the list of the members of a struct that are parameters.
///
///     struct Drive {
///         double kp = 1.0;
///         std::string side = "left";
///         bool turbo = false;
///     };
///     const auto fields = rect::fields<Drive>()
///                             .field("kp", &Drive::kp).range(0, 10).unit("1/s").about("gain of the heading")
///                             .field("side", &Drive::side).choices({"left", "right"})
///                             .field("turbo", &Drive::turbo);
template <class T>
[[nodiscard]] Fields<T> fields() {
    return {};
}

/// @cond
namespace detail {

template <class T>
using FieldList = std::shared_ptr<const std::vector<Field<T>>>;

template <class T>
T read_fields(const FieldList<T>& fields, const rect_parameter_values& raw) {
    T values{};
    for (std::size_t n = 0; n < raw.len && n < fields->size(); ++n) {
        (*fields)[n].read(values, raw.items[n]);
    }
    return values;
}

/// The functions of a group, which C calls.
template <class T>
struct GroupFunctions {
    FieldList<T> fields;
    std::function<void(const T&)> check;
    std::function<void(const T&, const ParameterChange&)> on_change;

    static bool call_check(const rect_parameter_values* values, char (*reason)[RECT_ERROR_BYTES], void* context) noexcept {
        acquire(context);
        bool is_accepted = false;
        const auto refuse = [&](const char* text) { std::snprintf(*reason, sizeof *reason, "%s", text); };
        const bool is_checked = guarded([&] {
            const auto& group = *static_cast<const GroupFunctions*>(context);
            try {
                group.check(read_fields(group.fields, *values));
                is_accepted = true;
            } catch (const Refusal& refusal) {
                refuse(refusal.what());
            } catch (const Exception& exception) {
                refuse(exception.what());
            }
        });
        if (!is_checked) {
            refuse("the check failed with an internal error");
        }
        release(context);
        release_all();
        return is_accepted;
    }

    static void call_on_change(const rect_parameter_change* change, void* context) noexcept {
        acquire(context);
        guarded([&] {
            const auto& group = *static_cast<const GroupFunctions*>(context);
            group.on_change(read_fields(group.fields, change->values), parameter_change(*change));
        });
        release(context);
        release_all();
    }
};

/// Declares the fields of a group with rect.h.
template <class T>
expected<Handle> declare(const char* group, const std::vector<Field<T>>& fields) {
    rect_parameters parameters{};
    rect_error error;
    auto code = rect_parameters_new(group, &parameters, &error);
    Handle handle(parameters.id);
    for (auto field = fields.begin(); code == RECT_CODE_OK && field != fields.end(); ++field) {
        code = field->add(parameters, &error);
    }
    return value_or_error<Handle>(code, error, [&] { return std::move(handle); });
}

}  // namespace detail
/// @endcond

/// A group of parameters of this program, which are the members of the struct `T`. Destroying it stores what has changed, ends the group,
/// and waits for calls in progress. Its last values remain visible, as those of a program that has ended.
///
///     const auto drive = rect::must(robot.parameters("drive", fields));
///     std::cout << drive.get()->kp << std::endl;
template <class T>
class ParameterGroup : public Handle {
public:
    ParameterGroup() = default;
    /// @cond
    ParameterGroup(std::uint64_t id, detail::FieldList<T> fields) : Handle(id), fields_(std::move(fields)) {}
    /// @endcond

    /// Returns the values that are in force. They belong together: a change is in all of them or in none.
    [[nodiscard]] expected<T> get() const {
        rect_parameter_values values;
        rect_error error;
        const auto code = rect_parameter_group_values(raw(), &values, &error);
        return detail::value_or_error<T>(code, error, [&] {
            const Handle handle(values.id);
            return detail::read_fields(fields_, values);
        });
    }

    /// Changes parameters, also read-only ones: all or none. They are in force when this function returns, and are published and stored
    /// in the background. Fails with Code::parameters and the reason if a value is refused.
    expected<void> set(const ParameterValues& values) const {
        const auto raw_values = detail::raw(values);
        rect_error error;
        return detail::ok_or_error(rect_parameter_group_set(raw(), raw_values.data(), raw_values.size(), &error), error);
    }

    /// Changes one parameter like the function above.
    expected<void> set(const std::string& name, const ParameterValue& value) const { return set(ParameterValues{{name, value}}); }

    /// Gives these parameters their defaults, also read-only ones. Without names: all parameters except for read-only ones. Fails like
    /// `set`.
    expected<void> reset(const std::vector<std::string>& names = {}) const {
        const auto all = detail::pointers(names);
        rect_error error;
        return detail::ok_or_error(rect_parameter_group_reset(raw(), all.data(), all.size(), &error), error);
    }

private:
    [[nodiscard]] rect_parameter_group raw() const noexcept { return {handle_id()}; }

    detail::FieldList<T> fields_;
};

}  // namespace RECT_ABI
}  // namespace rect

#endif
