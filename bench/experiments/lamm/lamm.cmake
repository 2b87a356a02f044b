# LAMM, a baseline of the experiments: bench/experiments/lamm, built for plain x86-64 as the mapper is, with which its
# times are compared. Reading, errors and files are the mapper's own.
find_package(CLI11 REQUIRED)
find_package(nlohmann_json REQUIRED)
set(lamm_mapper ${PROJECT_SOURCE_DIR}/examples/mapper)
add_executable(lamm
  experiments/lamm/main.cpp experiments/lamm/keyframe_sets.cpp experiments/lamm/merged_map.cpp
  experiments/lamm/lamm.cpp experiments/lamm/scan_graph.cpp
  ${lamm_mapper}/console.cpp ${lamm_mapper}/frame_table.cpp ${lamm_mapper}/output.cpp ${lamm_mapper}/results.cpp
  ${lamm_mapper}/run_summary.cpp)
target_include_directories(lamm PRIVATE experiments/lamm ${lamm_mapper} ${PROJECT_SOURCE_DIR}/examples)
target_compile_options(lamm PRIVATE -Wno-maybe-uninitialized -Wno-free-nonheap-object)
target_link_libraries(lamm PRIVATE chainslam_private chainslam_datasets chainslam_support chainslam_archive
  chainslam_cholmod CLI11::CLI11 nlohmann_json::nlohmann_json)
