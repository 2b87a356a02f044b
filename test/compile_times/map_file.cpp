// A map is read.
#include <chainslam/io/map_archive.hpp>

int main(int, char** arguments) { return chainslam::load_map(arguments[1]).report.complete ? 0 : 1; }
