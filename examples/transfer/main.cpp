// Transfer: sends a file of any size to another robot. The transfer resumes after an interruption of the link.
//
//     build/default/examples/transfer wombat-1                        # receives files into the folder `received`
//     build/default/examples/transfer wombat-2 wombat-1 map.bin       # sends a file
#include <cstdio>
#include <iostream>
#include <rect.hpp>

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));
    if (argc > 3) {
        const auto sent = robot.transfer(argv[2], "files", rect::File{argv[3]}, {}, [](const rect::Progress& progress) {
            std::printf("%3.0f %%\n", progress.fraction() * 100);
        });
        std::cout << argv[3] << ": " << (sent ? "complete" : sent.error().text) << std::endl;
        return sent ? 0 : 1;
    }
    rect::ReceiveOptions options;
    options.folder = "received";
    // Larger files are refused.
    options.max_bytes = 1 << 30;
    const auto files = rect::must(robot.receive_transfers("*/files", options));
    std::cout << rect::must(robot.name()) << " receives files; press Ctrl-C to stop" << std::endl;
    for (;;) {
        const auto file = files.next();
        if (file) {
            std::cout << file->name() << " from " << file->sender() << ": " << file->file() << std::endl;
        } else if (file.error().code == rect::Code::transfer_failed) {
            std::cout << file.error().text << std::endl;
        } else {
            return 0;
        }
    }
}
