#include <map>
#include <string>

#include "end_on_interrupt.hpp"
#include "map_export.hpp"
#include "map_file.hpp"
#include "saved_settings.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

const std::map<std::string, ExportFormat> formats = {{"tum", ExportFormat::tum},   {"kitti", ExportFormat::kitti},
                                                     {"g2o", ExportFormat::g2o},   {"ply", ExportFormat::ply},
                                                     {"pcd", ExportFormat::pcd},   {"las", ExportFormat::las},
                                                     {"grid", ExportFormat::grid}, {"colmap", ExportFormat::colmap}};

}  // namespace

int run(const ExportArguments& arguments) {
  const EndOnInterrupt interrupt(arguments.out);
  ExportOptions options = arguments.options;
  options.format = formats.at(arguments.format);
  const bool poses_alone = options.format == ExportFormat::tum || options.format == ExportFormat::kitti ||
                           options.format == ExportFormat::g2o;
  const LoadedMap loaded = open_map(arguments.map, {.scans = !poses_alone});
  if (options.format == ExportFormat::las || options.format == ExportFormat::grid) {
    const SavedSettings settings =
        saved_settings(loaded.parameters, arguments.map, "export with the version of chainslam that made the map");
    options.earth = settings.options.back_end.back_end.graph.gnss;
    if (const auto& T_body_lidar = settings.options.dataset.T_body_lidar)
      options.grid.sensor = T_body_lidar->translation();
  }
  return export_map(loaded.map, arguments.out, options);
}

}  // namespace chainslam::mapper
