// Provides a temporary folder.
#ifndef RECT_TESTS_FOLDER_HPP
#define RECT_TESTS_FOLDER_HPP

#include <cstdlib>
#include <filesystem>
#include <string>

#include "catch.hpp"

// A new folder, which is removed at the end.
class Folder {
public:
    Folder() {
        auto name = (std::filesystem::temp_directory_path() / "rect-XXXXXX").string();
        REQUIRE(mkdtemp(name.data()) != nullptr);
        path_ = name;
    }
    ~Folder() { std::filesystem::remove_all(path_); }
    Folder(const Folder&) = delete;
    Folder& operator=(const Folder&) = delete;

    std::string operator/(const char* name) const { return (path_ / name).string(); }

private:
    std::filesystem::path path_;
};

#endif
