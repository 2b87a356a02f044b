#include <cstdio>
#include <filesystem>
#include <map>
#include <memory>
#include <string>

#include "exit_code.hpp"
#include "map_export.hpp"
#include "map_file.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

const std::map<std::string, ExportFormat> formats = {{"tum", ExportFormat::tum},
                                                     {"kitti", ExportFormat::kitti},
                                                     {"g2o", ExportFormat::g2o},
                                                     {"ply", ExportFormat::ply},
                                                     {"pcd", ExportFormat::pcd}};

struct ExportArguments {
  std::filesystem::path map, out;
  std::string format;
  ExportOptions options;
};

int run(const ExportArguments& arguments) {
  ExportOptions options = arguments.options;
  options.format = formats.at(arguments.format);
  const bool scans = options.format == ExportFormat::ply || options.format == ExportFormat::pcd;
  const LoadedMap loaded = open_map(arguments.map, {.scans = scans});
  for (const std::filesystem::path& path : export_map(loaded.map, arguments.out, options))
    std::printf("written      %s\n", path.c_str());
  return exit_good;
}

}  // namespace

CLI::App* add_export(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<ExportArguments>();
  CLI::App* verb = program.add_subcommand("export", "write a map in another program's format");
  verb->footer(
      "tum, kitti: PATH is a folder, with a trajectory for each session and a joint one. g2o, ply, pcd: PATH is a "
      "file.\n"
      "Sessions that were not merged have frames of their own: each gets its own joint trajectory or cloud.");
  verb->add_option("MAP", arguments->map, "map file (.cslam)")->required()->option_text(" ");
  verb->add_option("--format", arguments->format, "tum, kitti, g2o, ply or pcd")
      ->required()
      ->check(CLI::IsMember({"tum", "kitti", "g2o", "ply", "pcd"}))
      ->option_text("FORMAT");
  verb->add_option("--out", arguments->out, "folder or file to write")->required()->option_text("PATH");
  verb->add_option("--voxel", arguments->options.voxel_size, "metres, of clouds; 0 keeps all points; default 0.2")
      ->check(CLI::Range(0.0, 10.0))
      ->option_text("SIZE");
  verb->add_flag("--overwrite", arguments->options.overwrite, "if PATH is there, keep that as PATH~1");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
  return verb;
}

}  // namespace chainslam::mapper
