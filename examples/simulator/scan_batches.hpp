#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "simulator/simulate.hpp"
#include "simulator/spinning_lidar.hpp"

namespace chainslam::simulator {

/// A revolution and its bytes.
struct EncodedScan {
  Revolution revolution;
  std::vector<std::byte> bytes;
};

/// Makes all scans of a drive (`TownDrive` or `RecordedDrive`) that arrive, batch by batch on all threads, and takes
/// them in order.
///
/// @param encode  the bytes of a revolution. @param take  called with each scan's number and what was made of it.
/// @param made  called with the scans that have been taken since the last call.
/// @returns the number of returns.
template <class AnyDrive, class Encode, class Take>
std::uint64_t for_each_scan(const AnyDrive& drive, const ChunkRunner& run_chunks, const Encode& encode,
                            const Take& take, const std::function<void(Index)>& made) {
  constexpr Index batch = 32;  // scans that are made, then taken together
  std::uint64_t points = 0;
  for (Index done = 0; done < drive.scan_count();) {
    const Index count = std::min(batch, drive.scan_count() - done);
    std::vector<EncodedScan> scans(static_cast<std::size_t>(count));
    run_chunks(count, 1, [&](Index begin, Index end) {
      for (Index i = begin; i < end; ++i) {
        if (!drive.lidar().arrives(done + i)) continue;
        EncodedScan& scan = scans[static_cast<std::size_t>(i)];
        scan.revolution = drive.revolution(done + i);
        scan.bytes = encode(scan.revolution);
      }
    });
    for (Index i = 0; i < count; ++i) {
      if (!drive.lidar().arrives(done + i)) continue;
      const EncodedScan& scan = scans[static_cast<std::size_t>(i)];
      take(done + i, scan);
      points += scan.revolution.returns.size();
    }
    done += count;
    made(count);
  }
  return points;
}

}  // namespace chainslam::simulator
