// Performs the calls of a behaviour scenario as the program of one robot.
#ifndef RECT_TESTS_PROGRAM_HPP
#define RECT_TESTS_PROGRAM_HPP

#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <rect/nlohmann.hpp>
#include <string>
#include <vector>

#include "pair.hpp"

// Returns the kind of an error as the scenarios name it.
inline std::string kind(rect::Code code) {
    switch (code) {
        case rect::Code::closed: return "closed";
        case rect::Code::dictionary: return "dictionary";
        case rect::Code::name: return "name";
        case rect::Code::not_reachable: return "not_reachable";
        case rect::Code::no_service: return "no_service";
        case rect::Code::option: return "option";
        case rect::Code::service: return "service";
        case rect::Code::timed_out: return "timed_out";
        case rect::Code::topic: return "topic";
        case rect::Code::transfer_refused: return "transfer_refused";
        default: return "another (" + std::to_string(static_cast<int>(code)) + ")";
    }
}

// The program of one robot. It keeps the objects that calls create, under their topics, patterns or names.
class Program {
    using Json = nlohmann::json;
    using Outcome = rect::expected<Json>;

public:
    // `dictionaries` are those of the scenarios, in hexadecimal digits.
    Program(rect::Robot robot, const Json& dictionaries) : robot_(std::move(robot)), dictionaries_(dictionaries) {}

    // Performs a call, and returns its result as the scenarios describe it.
    Outcome call(const Json& step) {
        const std::map<std::string, Outcome (Program::*)(const Json&)> calls{
            {"wait_for_peer", &Program::wait_for_peer},
            {"wait_until_established", &Program::wait_until_established},
            {"peers", &Program::peers},
            {"publish", &Program::publish},
            {"send", &Program::send},
            {"subscribe", &Program::subscribe},
            {"next", &Program::next},
            {"publisher", &Program::publisher},
            {"wait_for_subscriber", &Program::wait_for_subscriber},
            {"serve", &Program::serve},
            {"request", &Program::request},
            {"query_registry", &Program::query_registry},
            {"connections", &Program::connections},
            {"share_dictionary", &Program::share_dictionary},
            {"stream", &Program::stream},
            {"receive_transfers", &Program::receive_transfers},
            {"next_transfer", &Program::next_transfer},
            {"transfer", &Program::transfer},
            {"close", &Program::close},
        };
        return (this->*calls.at(step[0].get<std::string>()))(step);
    }

private:
    Outcome wait_for_peer(const Json& step) { return null_or_error(robot_.wait_for_peer(text(step[1]), timeout(step, 2))); }

    Outcome wait_until_established(const Json&) { return null_or_error(robot_.wait_until_established(deadline)); }

    Outcome peers(const Json&) {
        const auto peers = robot_.peers();
        return peers ? Outcome(Json(*peers)) : failed(peers);
    }

    Outcome publish(const Json& step) {
        const auto& robot = step.size() == 4 ? with_dictionary_.at(text(step[3])) : robot_;
        return null_or_error(robot.publish(text(step[1]), payload(step[2])));
    }

    Outcome send(const Json& step) {
        return null_or_error(robot_.send(text(step[1]), text(step[2]), payload(step[3])));
    }

    Outcome subscribe(const Json& step) { return keep(subscribers_, step[1], robot_.subscribe(text(step[1]))); }

    Outcome next(const Json& step) {
        const auto message = subscribers_.at(text(step[1])).next(timeout(step, 2));
        if (!message) {
            return failed(message);
        }
        return Json{message->sender(), message->topic(), read(message->payload)};
    }

    Outcome publisher(const Json& step) { return keep(publishers_, step[1], robot_.publisher(text(step[1]))); }

    Outcome wait_for_subscriber(const Json& step) {
        return null_or_error(publishers_.at(text(step[1])).wait_for_subscriber(timeout(step, 2)));
    }

    Outcome serve(const Json& step) {
        const auto kind = text(step[2]);
        return keep(services_, step[1], robot_.serve(text(step[1]), [kind](const rect::Request& request) {
            if (kind == "refuse") {
                throw rect::Refusal("there are the cells 1 and 2");
            }
            if (kind == "double") {
                return payload(Json(2 * must(request.payload.value<Json>()).get<int>()));
            }
            return payload(read(request.payload));
        }));
    }

    Outcome request(const Json& step) {
        const auto reply = robot_.request(text(step[1]), text(step[2]), payload(step[3]), deadline);
        return reply ? Outcome(Json{reply->sender(), read(reply->payload)}) : failed(reply);
    }

    Outcome query_registry(const Json& step) {
        const auto answer = robot_.query_registry(text(step[1]), text(step[2]));
        return answer ? Outcome(Json::parse(*answer)) : failed(answer);
    }

    Outcome connections(const Json& step) {
        const auto connections = robot_.connections(text(step[1]));
        if (!connections) {
            return failed(connections);
        }
        auto methods = Json::array();
        for (const auto& connection : *connections) {
            methods.push_back(connection.method);
        }
        return methods;
    }

    Outcome share_dictionary(const Json& step) {
        const auto hex = text(dictionaries_.at(text(step[1])));
        std::vector<std::uint8_t> bytes;
        for (std::size_t n = 0; n < hex.size(); n += 2) {
            bytes.push_back(static_cast<std::uint8_t>(std::stoi(hex.substr(n, 2), nullptr, 16)));
        }
        const auto dictionary = must(rect::Dictionary::read(bytes));
        return keep(with_dictionary_, step[1], robot_.with_dictionary(dictionary));
    }

    Outcome stream(const Json& step) {
        rect::StreamOptions options;
        options.max_frames_per_s = step[2].value("max_frames_per_s", 0.0);
        options.min_frames_per_s = step[2].value("min_frames_per_s", 0.0);
        options.max_bytes_per_s = step[2].value("max_bytes_per_s", 0.0);
        options.feedback_interval = std::chrono::milliseconds(std::lround(1000 * step[2].value("feedback_interval", 0.0)));
        const auto stream = robot_.stream(text(step[1]), options);
        return stream ? Outcome(Json()) : failed(stream);
    }

    Outcome receive_transfers(const Json& step) {
        rect::ReceiveOptions options;
        options.max_bytes = step[2].get<std::uint64_t>();
        return keep(transfers_, step[1], robot_.receive_transfers(text(step[1]), options));
    }

    Outcome next_transfer(const Json& step) {
        const auto received = transfers_.at(text(step[1])).next(deadline);
        if (!received) {
            return failed(received);
        }
        return Json{received->sender(), received->topic(), read(received->payload)};
    }

    Outcome transfer(const Json& step) {
        rect::TransferOptions options;
        options.timeout = deadline;
        return null_or_error(robot_.transfer(text(step[1]), text(step[2]), payload(step[3]), options));
    }

    Outcome close(const Json&) { return null_or_error(robot_.close()); }

    static std::string text(const Json& value) { return value.get<std::string>(); }

    // Returns the timeout of a call that may have one as its last argument, in milliseconds.
    static std::chrono::milliseconds timeout(const Json& step, std::size_t place) {
        return step.size() > place ? std::chrono::milliseconds(step[place].get<int>()) : deadline;
    }

    // Returns the payload of a value of a scenario: text as text, everything else as JSON.
    static rect::Payload payload(const Json& value) {
        return value.is_string() ? rect::Payload(text(value), "text/plain") : must(rect::Adapter<Json>::to_payload(value));
    }

    static Json read(const rect::PayloadView& payload) {
        return payload.encoding() == "text/plain" ? Json(must(payload.text())) : must(payload.value<Json>());
    }

    template <class T>
    static rect::unexpected<rect::Error> failed(const rect::expected<T>& outcome) {
        return rect::unexpected<rect::Error>(outcome.error());
    }

    static Outcome null_or_error(const rect::expected<void>& outcome) {
        return outcome ? Outcome(Json()) : failed(outcome);
    }

    template <class T>
    static Outcome keep(std::map<std::string, T>& kept, const Json& name, rect::expected<T> made) {
        if (!made) {
            return failed(made);
        }
        kept[text(name)] = std::move(*made);
        return Json();
    }

    rect::Robot robot_;
    Json dictionaries_;
    std::map<std::string, rect::Robot> with_dictionary_;
    std::map<std::string, rect::Subscriber> subscribers_;
    std::map<std::string, rect::Publisher> publishers_;
    std::map<std::string, rect::Service> services_;
    std::map<std::string, rect::Transfers> transfers_;
};

#endif
