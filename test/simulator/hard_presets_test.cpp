#include "simulator/hard_presets.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <set>
#include <utility>

#include "simulator/error_sources.hpp"
#include "simulator/preset_description.hpp"
#include "simulator/town_drive.hpp"

namespace chainslam::simulator {
namespace {

using Corners = std::pair<std::pair<Index, Index>, std::pair<Index, Index>>;

/// A street, whichever way it is driven.
Corners street_between(const Crossing& from, const Crossing& to) {
  const std::pair a(from.column, from.row), b(to.column, to.row);
  return {std::min(a, b), std::max(a, b)};
}

std::set<Corners> streets_driven(const SessionPlan& session) {
  std::set<Corners> streets;
  for (std::size_t i = 1; i < session.route.size(); ++i)
    streets.insert(street_between(session.route[i - 1], session.route[i]));
  return streets;
}

double planned_length(const Preset& preset, const SessionPlan& session) {
  return preset.town.streets.block * static_cast<double>(session.route.size() - 1);
}

TEST_SUITE("simulator/hard_presets") {
  TEST_CASE("worlds are those that the tables were made of: who changes one has to make its tables again") {
    // As the program simulates them, which chooses error sources: passages then come in their order.
    const auto hash_of = [](const char* name, PresetSize size) {
      return options_hash(without_errors(with_only_errors(*preset(name, size), "all"), ""));
    };
    CHECK(hash_of("nclt-hard", PresetSize::small) == "3f56c72bf79fa1e1");
    CHECK(hash_of("nclt-hard", PresetSize::medium) == "1a70bbe41fd0882d");
    CHECK(hash_of("nclt-hard", PresetSize::large) == "4888eade287da9d8");
    CHECK(hash_of("mars-hard", PresetSize::small) == "90f49d0536af9ce2");
    CHECK(hash_of("mars-hard", PresetSize::medium) == "62c14ad40ac4d755");
    CHECK(hash_of("mars-hard", PresetSize::large) == "e626e53b0d21f1dd");
  }

  TEST_CASE("five sessions are as long as in the data that the worlds stand for, and meet") {
    struct Expected {
      Preset preset;
      double least, most;  // metres
    };
    const std::array<Expected, 4> worlds{{{nclt_hard(PresetSize::medium), 1.2e3, 1.8e3},
                                          {nclt_hard(PresetSize::large), 4.5e3, 5.5e3},
                                          {mars_hard(PresetSize::medium), 2.7e3, 3.3e3},
                                          {mars_hard(PresetSize::large), 5.7e3, 6.6e3}}};
    for (const Expected& expected : worlds) {
      const Preset& world = expected.preset;
      CAPTURE(world.name);
      REQUIRE(world.sessions.size() == 5);
      for (const SessionPlan& session : world.sessions) {
        CHECK(planned_length(world, session) >= expected.least);
        CHECK(planned_length(world, session) <= expected.most);
        const std::set<Corners> own = streets_driven(session);
        std::set<Corners> of_others;
        for (const SessionPlan& other : world.sessions)
          if (&other != &session) of_others.merge(streets_driven(other));
        const auto shared = std::ranges::count_if(own, [&](const Corners& one) { return of_others.contains(one); });
        CHECK(static_cast<double>(shared) >= 0.4 * static_cast<double>(own.size()));
      }
    }
  }

  TEST_CASE("what is hard about a car's world lies on the way of some session") {
    for (const PresetSize size : {PresetSize::medium, PresetSize::large}) {
      const Preset world = mars_hard(size);
      std::set<Corners> driven;
      for (const SessionPlan& session : world.sessions) driven.merge(streets_driven(session));
      for (const Passage& passage : world.town.passages)
        CHECK(driven.contains(street_between(passage.from, passage.to)));
    }
  }

  TEST_CASE("a tenth to a third of what a car sees moves") {
    const TownDrive drive(mars_hard(PresetSize::small), 1);
    double moving = 0, all = 0;
    for (Index scan = 0; scan < drive.scan_count(); scan += 50)
      for (const LidarReturn& hit : drive.revolution(scan).returns) {
        ++all;
        moving += hit.presence == Presence::moving ? 1 : 0;
      }
    CAPTURE(moving / all);
    CHECK(moving >= 0.1 * all);
    CHECK(moving <= 0.33 * all);
  }
}

}  // namespace
}  // namespace chainslam::simulator
