// Checks after each test that it has dropped all its handles. A leak sanitizer does not notice handles that remain, because
// the library's table still refers to their objects.
#include <cstdio>
#include <cstdlib>
#include <rect.hpp>
#include <string>

#include "catch.hpp"

namespace {

class HandleLeakCheck : public EventListener {
public:
    using EventListener::EventListener;

    void testCaseStarting(const Catch::TestCaseInfo& test) override {
        name_ = test.name;
        before_ = rect_handle_count();
    }
    void testCaseEnded(const Catch::TestCaseStats&) override {
        if (rect_handle_count() != before_) {
            std::fprintf(stderr, "%s: %zu handles were not dropped\n", name_.c_str(), rect_handle_count() - before_);
            std::abort();
        }
    }

private:
    std::string name_;
    std::size_t before_ = 0;
};

}  // namespace

CATCH_REGISTER_LISTENER(HandleLeakCheck)
