#include "datasets/statistics.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <limits>

#include "chainslam/core/types.hpp"

namespace chainslam::datasets {

std::string text_of(double value, int decimals) {
  std::array<char, 400> digits{};
  const auto end =
      std::to_chars(digits.data(), digits.data() + digits.size(), value, std::chars_format::fixed, decimals);
  std::string text(digits.data(), end.ptr);
  if (text.find('.') == text.npos) return text;
  text.erase(text.find_last_not_of('0') + 1);
  if (text.back() == '.') text.pop_back();
  return text == "-0" ? "0" : text;
}

void TimeStatistics::add(Timestamp time) {
  if (count_ == 0)
    first_ = time;
  else
    steps_.push_back(time - last_);
  last_ = time;
  ++count_;
}

void TimeStatistics::report(const std::string& name, Facts& facts, std::vector<std::string>& warnings) const {
  std::string text = std::to_string(count_);
  if (steps_.empty()) {
    facts.emplace_back(name, text);
    return;
  }
  std::vector<Duration> sorted = steps_;
  std::ranges::sort(sorted);
  const Duration usual = sorted[sorted.size() / 2];
  text += ", " + text_of(to_seconds(last_ - first_)) + " s";
  if (usual > Duration::zero()) text += ", usually " + text_of(1 / to_seconds(usual), 2) + " Hz";
  facts.emplace_back(name, text + ", longest step " + text_of(to_seconds(sorted.back())) + " s");
  const auto gaps = std::ranges::count_if(steps_, [&](Duration step) { return 2 * step > 5 * usual; });
  if (gaps > 0 && usual > Duration::zero())
    warnings.push_back(name + ": " + std::to_string(gaps) + " gaps, the longest of " +
                       text_of(to_seconds(sorted.back())) + " s");
  const auto back = std::ranges::count_if(steps_, [](Duration step) { return step < Duration::zero(); });
  if (back > 0) warnings.push_back(name + ": " + std::to_string(back) + " steps back in time");
  const auto repeated = std::ranges::count(steps_, Duration::zero());
  if (repeated > 0) warnings.push_back(name + ": " + std::to_string(repeated) + " times repeated");
}

void CloudStatistics::add(const PointCloud<float>& cloud) {
  if (sizes_.empty()) {
    if (cloud.has_intensities()) columns_.emplace_back("intensities");
    if (cloud.has_normals()) columns_.emplace_back("normals");
    if (cloud.has_times()) columns_.emplace_back("times");
  }
  sizes_.push_back(cloud.size());
  points_ += cloud.size();
  for (const Eigen::Vector3f& p : cloud.positions) {
    if (!is_finite(p)) {
      ++not_finite_;
      continue;
    }
    at_origin_ += p.isZero(0) ? 1 : 0;
    low_ = low_.cwiseMin(p);
    high_ = high_.cwiseMax(p);
    farthest_ = std::max(farthest_, p.norm());
  }
}

void CloudStatistics::report(Facts& facts, std::vector<std::string>& warnings) const {
  if (sizes_.empty()) return;
  std::string text = std::to_string(points_);
  if (sizes_.size() > 1) {
    std::vector<std::size_t> sorted = sizes_;
    std::ranges::sort(sorted);
    text += ", of a scan " + std::to_string(sorted.front()) + " to " + std::to_string(sorted.back()) + ", median " +
            std::to_string(sorted[sorted.size() / 2]);
    const auto empty = std::ranges::count(sorted, std::size_t{0});
    if (empty > 0) warnings.push_back(std::to_string(empty) + " scans without points");
  }
  for (std::size_t i = 0; i < columns_.size(); ++i) text += (i == 0 ? "; with " : ", ") + columns_[i];
  facts.emplace_back("points", text);
  if (points_ > not_finite_) {
    std::string extent;
    for (int k = 0; k < 3; ++k)
      extent += std::string(k == 0 ? "" : ", ") + "xyz"[k] + " " + text_of(static_cast<double>(low_[k]), 2) + " to " +
                text_of(static_cast<double>(high_[k]), 2);
    facts.emplace_back("extent", extent + " m; farthest " + text_of(static_cast<double>(farthest_), 2) + " m");
  }
  if (not_finite_ > 0) warnings.push_back(std::to_string(not_finite_) + " points that are NaN or infinite");
  if (at_origin_ > 0) warnings.push_back(std::to_string(at_origin_) + " points at the origin");
}

}  // namespace chainslam::datasets
