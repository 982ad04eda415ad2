// Looks after each test whether it has dropped all that it had: what has an id still, no leak sanitizer misses.
#include <cstdio>
#include <cstdlib>
#include <rect.hpp>

#include "catch_amalgamated.hpp"

namespace {

class Leaks : public Catch::EventListenerBase {
public:
    using Catch::EventListenerBase::EventListenerBase;

    void testCaseStarting(const Catch::TestCaseInfo&) override { before_ = rect_live(); }
    void testCaseEnded(const Catch::TestCaseStats& stats) override {
        if (rect_live() != before_) {
            std::fprintf(stderr, "%s: %zu things have an id still\n", stats.testInfo->name.c_str(), rect_live() - before_);
            std::abort();
        }
    }

private:
    std::size_t before_ = 0;
};

}  // namespace

CATCH_REGISTER_LISTENER(Leaks)
