# The peer of place recognition: MapClosures, from its sources and those of what it needs, with OpenCV as Debian has it.
set(CHAINSLAM_PEER_MAP_CLOSURES "" CACHE PATH "Sources of MapClosures, to be compared with; needs the next two and libopencv-dev")
set(CHAINSLAM_PEER_HBST "" CACHE PATH "Sources of srrg_hbst, part of MapClosures")
set(CHAINSLAM_PEER_SOPHUS "" CACHE PATH "Sources of Sophus, part of MapClosures")

# chainslam_link_map_closures(TARGET): compiles the peer into a library and links it, if its sources are there.
function(chainslam_link_map_closures target)
  chainslam_peer_path(path CHAINSLAM_PEER_MAP_CLOSURES cpp/map_closures/MapClosures.hpp)
  chainslam_peer_path(hbst CHAINSLAM_PEER_HBST srrg_hbst/types/binary_tree.hpp)
  chainslam_peer_path(sophus CHAINSLAM_PEER_SOPHUS sophus/se3.hpp)
  if(NOT path)
    return()
  endif()
  find_package(OpenCV REQUIRED COMPONENTS core features2d imgproc)
  file(GLOB sources CONFIGURE_DEPENDS ${path}/cpp/map_closures/*.cpp)
  add_library(chainslam_peer_map_closures STATIC EXCLUDE_FROM_ALL ${CMAKE_CURRENT_SOURCE_DIR}/slam/peers/map_closures.cpp ${sources})
  target_include_directories(chainslam_peer_map_closures PRIVATE ${CMAKE_CURRENT_SOURCE_DIR})
  target_include_directories(chainslam_peer_map_closures SYSTEM PRIVATE ${path}/cpp/map_closures ${hbst} ${sophus})
  target_compile_options(chainslam_peer_map_closures PRIVATE -O3 -march=native -w)
  target_compile_definitions(chainslam_peer_map_closures PRIVATE SRRG_HBST_HAS_EIGEN SRRG_HBST_HAS_OPENCV
    SRRG_MERGE_DESCRIPTORS SOPHUS_USE_BASIC_LOGGING PUBLIC CHAINSLAM_PEER_MAP_CLOSURES)
  target_link_libraries(chainslam_peer_map_closures PRIVATE chainslam_private ${OpenCV_LIBS})
  target_link_libraries(${target} PRIVATE chainslam_peer_map_closures)
endfunction()
