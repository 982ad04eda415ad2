// Hello: publishes a message, sends a request, and prints what another robot publishes. Start `rect sim` first.
//
//     build/default/examples/hello
#include <iostream>
#include <rect.hpp>

int main() {
    const auto robot = rect::must(rect::connect("wombat-1"));
    // Every program that subscribes to greetings receives this.
    rect::must(robot.publish("greeting", "hello"));
    // Only this program receives the reply.
    const auto battery = rect::must(robot.request("wombat-2", "battery", ""));
    std::cout << "battery of " << battery.sender() << ": " << rect::must(battery.payload.text()) << std::endl;
    // Until Ctrl-C.
    const auto messages = rect::must(robot.subscribe("wombat-2/**"));
    for (;;) {
        const auto message = rect::must(messages.next());
        const auto text = rect::must(message.payload.text());
        std::cout << message.sender() << " " << message.topic() << ": " << text << std::endl;
    }
}
