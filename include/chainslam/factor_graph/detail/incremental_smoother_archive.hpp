#pragma once

#include <algorithm>
#include <array>
#include <iterator>
#include <stdexcept>

#include "chainslam/core/table.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_class.hpp"

// How `IncrementalSmoother` is saved and loaded.

namespace chainslam {

template <class Group, class... Extra>
template <class Archive>
void IncrementalSmoother<Group, Extra...>::visit_options(SmootherOptions& options, Archive&& archive) {
  archive(options.linear_tolerance, options.nonlinear_tolerance, options.patience, options.first_look,
          options.longest_step, options.least_error, options.largest_relinearization, options.late_variables,
          options.lag);
}

template <class Group, class... Extra>
std::vector<std::byte> IncrementalSmoother<Group, Extra...>::save() const {
  if (open_) throw std::invalid_argument("IncrementalSmoother: changes wait for update; update or undo before saving");
  ByteSink out = detail::begin_state({dof, Pools::fingerprint()});
  detail::StateWriter write(out);
  SmootherOptions options = options_;
  visit_options(options, write);
  out.put(static_cast<std::uint64_t>(size()));
  for (const Group& origin : origins_) write(origin);
  out.put_list(look_);
  out.put_list(marginalized_);
  detail::Table<Key> waiting = waiting_;
  waiting.keep_if([](Key key) { return key != -1; });
  out.put_list(waiting);
  out.put_list(far_);
  out.put_list(off_);
  out.put(waiting_gap_);
  std::vector<std::vector<Index>> released(static_cast<std::size_t>(Pools::types));
  for (const Change& change : changes_) {
    if (change.kind != ChangeKind::factor_removed) continue;
    const auto place = pools_.place(change.id);
    released[static_cast<std::size_t>(place.type)].push_back(place.slot);
  }
  pools_.save(out, released);
  solver_.save(out);
  return detail::end_state(std::move(out));
}

template <class Group, class... Extra>
IncrementalSmoother<Group, Extra...> IncrementalSmoother<Group, Extra...>::load(std::span<const std::byte> bytes,
                                                                                const std::string& name) {
  ByteSource in = detail::check_state(bytes, {dof, Pools::fingerprint()}, name);
  detail::StateReader read(in);
  SmootherOptions options;
  visit_options(options, read);
  IncrementalSmoother smoother(options);
  const auto count = in.take<std::uint64_t>();
  for (std::uint64_t k = 0; k < count; ++k) {
    Group origin;
    read(origin);
    smoother.origins_.add(origin);
    smoother.estimates_.add(origin);
  }
  in.take_list(smoother.look_);
  in.take_list(smoother.marginalized_);
  in.take_list(smoother.waiting_);
  in.take_list(smoother.far_);
  in.take_list(smoother.off_);
  smoother.waiting_gap_ = in.take<double>();
  smoother.waits_at_.assign(smoother.look_.size(), -1);
  smoother.find_waiting();
  smoother.pools_.load(in);
  smoother.solver_.load(in);
  smoother.estimate_all();
  smoother.touched_.assign(smoother.solver_.terms().count(), 0);
  smoother.components_outdated_ = true;
  smoother.revision_ = 2;
  return smoother;
}

}  // namespace chainslam
