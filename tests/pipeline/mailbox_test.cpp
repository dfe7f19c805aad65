// SPDX-License-Identifier: BSD-3-Clause
#include "mailbox.hpp"

#include <memory>

#include "testing.hpp"

namespace loopwise {
namespace {

/// A message for which there is no memory while it is told so.
struct Message {
  explicit Message(int n) : number(n) {}
  Message(Message&& other) : number(other.number) {
    if (failures > 0) {
      --failures;
      throw std::bad_alloc();
    }
  }
  int number;
  inline static int failures = 0;
};

TEST_CASE("mailbox: what comes from inside waits for memory", "[pipeline][mailbox]") {
  Patience patience{StopToken()};
  Mailbox<Message> mailbox(1, patience);
  Message::failures = 3;
  REQUIRE(mailbox.post_inside(Message(7)));
  REQUIRE(Message::failures == 0);
  REQUIRE(mailbox.next(false)->number == 7);
  REQUIRE_FALSE(patience.lost());
}

TEST_CASE("mailbox: what finds no memory after a stop is lost in the end, and its answer is not waited for",
          "[pipeline][mailbox]") {
  StopSource source;
  Patience patience(source.token());
  Mailbox<Message> mailbox(1, patience), other(1, patience);
  REQUIRE(mailbox.post_inside(Message(1)));
  mailbox.close();
  source.request_stop();
  Message::failures = 1000000;
  REQUIRE_FALSE(other.post_inside(Message(2)));
  const int tried = 1000000 - std::exchange(Message::failures, 0);
  REQUIRE(tried > 2);
  REQUIRE(patience.lost());
  REQUIRE(mailbox.next(true)->number == 1);  // what is here still comes
  REQUIRE_FALSE(mailbox.next(true).has_value());
}

TEST_CASE("patience: each request has its time, until one is given up", "[pipeline][mailbox]") {
  StopSource source;
  Patience patience(source.token());
  Patience::Asked before, first, second;
  REQUIRE(patience.wait(before));
  REQUIRE_FALSE(before.has_value());  // as no stop is requested
  source.request_stop();
  REQUIRE(patience.wait(first));
  *first -= std::chrono::seconds(2);
  REQUIRE(patience.wait(second));  // that another began long ago says nothing of this one
  REQUIRE_FALSE(patience.given_up());
  REQUIRE_FALSE(patience.wait(first));
  REQUIRE_FALSE(patience.wait(second));
  REQUIRE(patience.given_up());
  REQUIRE_FALSE(patience.lost());
}

}  // namespace
}  // namespace loopwise
