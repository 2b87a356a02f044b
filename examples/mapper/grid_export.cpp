#include "grid_export.hpp"

#include "chainslam/io/detail/pose_fields.hpp"

namespace chainslam::mapper {

namespace {

constexpr double occupied_from = 0.65, free_to = 0.35;  // probabilities

char gray_of(const OccupancyGrid<>& grid, LogOdds::Cell cell) {
  const double probability = grid.model.probability(cell);
  return static_cast<char>(probability > occupied_from ? 0 : probability < free_to ? 254 : 205);
}

/// A name between quotes in YAML.
std::string quoted(const std::string& name) {
  std::string text = "\"";
  for (const char c : name) {
    if (c == '"' || c == '\\') text += '\\';
    text += c;
  }
  return text + '"';
}

}  // namespace

GridFiles grid_files(const std::filesystem::path& path) {
  const auto extension = path.extension();
  const bool named = extension == ".yaml" || extension == ".yml" || extension == ".pgm";
  const std::filesystem::path stem = named ? std::filesystem::path(path).replace_extension() : path;
  GridFiles files{stem, stem};
  files.image += ".pgm";
  files.yaml += extension == ".yml" ? ".yml" : ".yaml";
  return files;
}

void write_grid_image(const FileTarget& target, const OccupancyGrid<>& grid) {
  AtomicFile file(target);
  file.write("P5\n" + std::to_string(grid.width) + ' ' + std::to_string(grid.height) + "\n255\n");
  std::string row(static_cast<std::size_t>(grid.width), '\0');
  for (Index y = grid.height; y-- > 0;) {
    for (Index x = 0; x < grid.width; ++x) row[static_cast<std::size_t>(x)] = gray_of(grid, grid.at(x, y));
    file.write(row);
  }
  file.commit();
}

void write_grid_yaml(const FileTarget& target, const OccupancyGrid<>& grid, const std::string& image) {
  std::string text = "image: " + quoted(image) + "\nmode: trinary\nresolution: ";
  detail::append_number(text, grid.resolution);
  text += "\norigin: [";
  for (const double coordinate : {grid.origin.x(), grid.origin.y()}) {
    detail::append_number(text, coordinate);
    text += ", ";
  }
  // A picture's 205 is 0.196 occupied: the bound below which it would be free.
  text += "0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n";
  AtomicFile file(target);
  file.write(text);
  file.commit();
}

}  // namespace chainslam::mapper
