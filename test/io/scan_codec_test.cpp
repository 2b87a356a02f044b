#include <doctest/doctest.h>

#include "chainslam/io/detail/scan_codec.hpp"
#include "chainslam/io/detail/zstd_codec.hpp"
#include "io/maps.hpp"
#include "support/property.hpp"

namespace chainslam::test {
namespace {

PointCloud<float> through_codec(const PointCloud<float>& cloud, std::uint32_t& encoding) {
  std::vector<std::byte> bytes;
  chainslam::detail::append_scan(bytes, KeyframeId{42}, cloud);
  chainslam::detail::ByteReader in(bytes);
  const auto head = chainslam::detail::read_scan_head(in);
  CHECK(head.keyframe == KeyframeId{42});
  CHECK(head.points == cloud.size());
  CHECK(in.left() == chainslam::detail::scan_body_bytes(head.encoding, head.columns, head.points));
  encoding = head.encoding;
  PointCloud<float> result = chainslam::detail::read_scan_body(head, in);
  CHECK(in.left() == 0);
  return result;
}

bool same(const PointCloud<float>& a, const PointCloud<float>& b) {
  return same_cloud(std::make_shared<const PointCloud<float>>(a), std::make_shared<const PointCloud<float>>(b));
}

}  // namespace

TEST_SUITE("io/scan_codec") {
  TEST_CASE("every scan comes back bit for bit, on a grid or not, in its order") {
    for_all(100, [](Rng& rng, int size) {
      PointCloud<float> cloud = random_cloud(rng, size - 1);
      std::uint32_t encoding = 9;
      CHECK(same(through_codec(cloud, encoding), cloud));
      if (size > 1) CHECK(encoding == chainslam::detail::scan_of_floats);
      for (const double step : {0.01, 0.02, 0.001, 0.005, 0.16}) {
        PointCloud<float> rounded = quantized(cloud, step);
        std::reverse(rounded.positions.begin(), rounded.positions.end());
        CHECK(same(through_codec(rounded, encoding), rounded));
        CHECK(encoding == chainslam::detail::scan_on_grid);
      }
      cloud.normals.assign(cloud.size(), {std::numeric_limits<float>::quiet_NaN(), -0.0F, 1});
      cloud.intensities.assign(cloud.size(), 3);
      CHECK(same(through_codec(cloud, encoding), cloud));
    });
  }

  TEST_CASE("differences of any two numbers come back") {
    for_all(1000, [](Rng& rng, int) {
      const auto from = static_cast<std::int16_t>(rng.bits()), to = static_cast<std::int16_t>(rng.bits());
      CHECK(chainslam::detail::unzigzag(from, chainslam::detail::zigzag(from, to)) == to);
    });
    CHECK(chainslam::detail::zigzag(5, 5) == 0);
    CHECK(chainslam::detail::zigzag(5, 4) == 1);
    CHECK(chainslam::detail::zigzag(5, 6) == 2);
    CHECK(chainslam::detail::unzigzag(-32768, chainslam::detail::zigzag(-32768, 32767)) == 32767);
  }

  TEST_CASE("codecs give back what they took, and refuse what is damaged or of another size") {
    Rng rng(1);
    std::vector<std::byte> data(5000);
    for (std::byte& byte : data) byte = static_cast<std::byte>(rng.uniform_index(4));
    const auto check = [&](const Codec auto& codec) {
      const std::vector<std::byte> packed = codec.compress(data);
      std::vector<std::byte> out(data.size());
      CHECK(codec.decompress(packed, out));
      CHECK(out == data);
      for (const std::size_t size : {std::size_t{0}, data.size() - 1, data.size() + 1}) {
        std::vector<std::byte> other(size);
        CHECK(!codec.decompress(packed, other));
      }
      CHECK(!codec.decompress(std::span(packed).first(packed.size() / 2), out));
      CHECK(codec.decompress(codec.compress({}), {}));
    };
    check(RawCodec{});
    check(chainslam::detail::ZstdCodec{});
    CHECK(chainslam::detail::ZstdCodec{}.compress(data).size() < data.size() / 3);
    CHECK(!chainslam::detail::ZstdCodec{}.decompress(data, data));
    static_assert(!Codec<int>);
  }
}

}  // namespace chainslam::test
