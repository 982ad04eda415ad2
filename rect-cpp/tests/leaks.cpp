// Checks after each test that it has dropped all its handles. A leak sanitizer does not notice handles that remain, because
// the library's table still refers to their objects.
#include <cstdio>
#include <cstdlib>
#include <rect.hpp>

#include "catch_amalgamated.hpp"

namespace {

class HandleLeakCheck : public Catch::EventListenerBase {
public:
    using Catch::EventListenerBase::EventListenerBase;

    void testCaseStarting(const Catch::TestCaseInfo&) override { before_ = rect_handle_count(); }
    void testCaseEnded(const Catch::TestCaseStats& stats) override {
        if (rect_handle_count() != before_) {
            const auto name = stats.testInfo->name.c_str();
            std::fprintf(stderr, "%s: %zu handles were not dropped\n", name, rect_handle_count() - before_);
            std::abort();
        }
    }

private:
    std::size_t before_ = 0;
};

}  // namespace

CATCH_REGISTER_LISTENER(HandleLeakCheck)
