#include <map>
#include <string>

#include "end_on_interrupt.hpp"
#include "map_export.hpp"
#include "map_file.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

const std::map<std::string, ExportFormat> formats = {{"tum", ExportFormat::tum}, {"kitti", ExportFormat::kitti},
                                                     {"g2o", ExportFormat::g2o}, {"ply", ExportFormat::ply},
                                                     {"pcd", ExportFormat::pcd}, {"colmap", ExportFormat::colmap}};

}  // namespace

int run(const ExportArguments& arguments) {
  const EndOnInterrupt interrupt(arguments.out);
  ExportOptions options = arguments.options;
  options.format = formats.at(arguments.format);
  const bool scans = options.format == ExportFormat::ply || options.format == ExportFormat::pcd ||
                     options.format == ExportFormat::colmap;
  const LoadedMap loaded = open_map(arguments.map, {.scans = scans});
  return export_map(loaded.map, arguments.out, options);
}

}  // namespace chainslam::mapper
