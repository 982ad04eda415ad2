// Transfer: a file of any size goes to another robot, over a radio that comes and goes.
//
//     build/default/examples/transfer wombat-1                        # takes files, into the folder `received`
//     build/default/examples/transfer wombat-2 wombat-1 map.bin       # sends one
#include <cstdio>
#include <iostream>
#include <rect.hpp>

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));
    if (argc > 3) {
        const auto sent = robot.transfer(argv[2], "files", rect::File{argv[3]}, {}, [](const rect::Progress& progress) {
            std::printf("%3.0f %%\n", progress.fraction() * 100);
        });
        std::cout << argv[3] << (sent ? " is there, whole" : ": " + sent.error().text) << std::endl;
        return sent ? 0 : 1;
    }
    rect::ReceiveOptions options;
    options.folder = "received";
    // Whoever sends more is refused.
    options.max_bytes = 1 << 30;
    const auto files = rect::must(robot.receive_transfers("*/files", options));
    std::cout << rect::must(robot.name()) << " takes files; Ctrl-C ends this" << std::endl;
    for (;;) {
        const auto file = files.next();
        if (file) {
            std::cout << file->name() << " of " << file->from() << ": " << file->file() << std::endl;
        } else if (file.error().code == rect::Code::transfer_failed) {
            std::cout << file.error().text << std::endl;
        } else {
            return 0;
        }
    }
}
