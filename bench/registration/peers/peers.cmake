# The peers of rooms cloud, features and registration: one adapter each, compiled once a column with the flags of the
# bench, in a library of its own that carries the definition CHAINSLAM_PEER_<NAME>. Benches call them behind it.

option(CHAINSLAM_BENCH_PEERS "Build the comparisons with PCL and Open3D, as Debian has them" OFF)
set(CHAINSLAM_PEER_SMALL_GICP "" CACHE PATH "Sources of small_gicp, to be timed against")
set(CHAINSLAM_PEER_KISS_MATCHER "" CACHE PATH "Sources of KISS-Matcher, to be timed against; needs the next three")
set(CHAINSLAM_PEER_ROBIN "" CACHE PATH "Sources of ROBIN, part of KISS-Matcher")
set(CHAINSLAM_PEER_XENIUM "" CACHE PATH "Sources of xenium (github.com/mpoeter/xenium), part of ROBIN")
set(CHAINSLAM_PEER_PMC "" CACHE PATH "Sources of pmc (github.com/jingnanshi/pmc), part of ROBIN and of TEASER++")
set(CHAINSLAM_PEER_TEASER "" CACHE PATH "Sources of TEASER++, to be timed against; needs pmc")

# chainslam_peer_path(RESULT VARIABLE HEADER): the absolute path that the cache variable names, below which HEADER must
# exist; empty where it is not set.
function(chainslam_peer_path result variable header)
  set(path "${${variable}}")
  if(NOT path STREQUAL "")
    get_filename_component(path "${path}" ABSOLUTE BASE_DIR ${CMAKE_SOURCE_DIR})
    if(NOT EXISTS "${path}/${header}")
      message(FATAL_ERROR "${variable}=${path}: there is no ${header} below it; give the root of that project's sources")
    endif()
  endif()
  set(${result} "${path}" PARENT_SCOPE)
endfunction()

# chainslam_peer_library(NAME SUFFIX FLAGS INCLUDES... [SOURCES...] [LIBRARIES...] [DEFINITIONS...]): the adapter
# peers/NAME.cpp and the peer's own sources, which are not held to our warnings.
function(chainslam_peer_library name suffix flags)
  cmake_parse_arguments(peer "" "" "INCLUDES;SOURCES;LIBRARIES;DEFINITIONS" ${ARGN})
  string(TOUPPER ${name} upper)
  set(adapter chainslam_peer_${name}${suffix})
  add_library(${adapter} STATIC EXCLUDE_FROM_ALL ${chainslam_peers_folder}/${name}.cpp)
  target_include_directories(${adapter} PRIVATE ${CMAKE_CURRENT_SOURCE_DIR})
  target_include_directories(${adapter} SYSTEM PRIVATE ${peer_INCLUDES})
  target_compile_options(${adapter} PRIVATE ${flags})
  target_compile_definitions(${adapter} PRIVATE ${peer_DEFINITIONS} PUBLIC CHAINSLAM_PEER_${upper})
  target_link_libraries(${adapter} PRIVATE chainslam_private ${peer_LIBRARIES})
  if(peer_SOURCES)
    add_library(${adapter}_sources STATIC EXCLUDE_FROM_ALL ${peer_SOURCES})
    target_include_directories(${adapter}_sources SYSTEM PRIVATE ${peer_INCLUDES})
    target_compile_options(${adapter}_sources PRIVATE ${flags} -w)
    target_compile_features(${adapter}_sources PRIVATE cxx_std_17)
    target_compile_definitions(${adapter}_sources PRIVATE ${peer_DEFINITIONS})
    target_link_libraries(${adapter}_sources PRIVATE Eigen3::Eigen ${peer_LIBRARIES})
    target_link_libraries(${adapter} PRIVATE ${adapter}_sources)
  endif()
  target_link_libraries(chainslam_registration_peers${suffix} INTERFACE ${adapter})
endfunction()

set(chainslam_peers_folder ${CMAKE_CURRENT_LIST_DIR})

# The target chainslam_registration_peers<SUFFIX>, which links all peers of this build.
function(chainslam_registration_peers suffix flags)
  add_library(chainslam_registration_peers${suffix} INTERFACE)
  chainslam_peer_path(path CHAINSLAM_PEER_SMALL_GICP include/small_gicp/registration/registration.hpp)
  if(path)
    chainslam_peer_library(small_gicp "${suffix}" "${flags}" INCLUDES ${path}/include)
  endif()
  chainslam_peer_path(kiss CHAINSLAM_PEER_KISS_MATCHER cpp/kiss_matcher/core/kiss_matcher/KISSMatcher.cpp)
  chainslam_peer_path(teaser CHAINSLAM_PEER_TEASER teaser/include/teaser/registration.h)
  if(kiss OR teaser)
    chainslam_clique_peers("${suffix}" "${flags}" "${kiss}" "${teaser}")
  endif()
  if(CHAINSLAM_BENCH_PEERS)
    chainslam_debian_peers("${suffix}" "${flags}")
  endif()
endfunction()

# PCL and Open3D. Their libraries hold Eigen's types aligned to 16 bytes, whatever the flags of the bench. PCL's templates
# are compiled here, with these flags; Open3D is as Debian compiled it.
function(chainslam_debian_peers suffix flags)
  find_package(OpenMP REQUIRED)
  find_library(CHAINSLAM_LZ4_LIBRARY lz4 REQUIRED)
  find_path(CHAINSLAM_PCL_INCLUDE pcl/registration/gicp.h PATH_SUFFIXES pcl-1.13 pcl-1.12 pcl-1.14 REQUIRED)
  set(libraries)
  foreach(module common kdtree search sample_consensus filters features registration)
    find_library(CHAINSLAM_PCL_${module} pcl_${module} REQUIRED)
    list(APPEND libraries ${CHAINSLAM_PCL_${module}})
  endforeach()
  # Compiled without AVX, its inlined Eigen makes g++ 12 see a use after a free that is on another path.
  chainslam_peer_library(pcl "${suffix}" "${flags};-Wno-use-after-free" INCLUDES ${CHAINSLAM_PCL_INCLUDE}
                         DEFINITIONS EIGEN_MAX_ALIGN_BYTES=16 PCL_NO_PRECOMPILE
                         LIBRARIES ${libraries} ${CHAINSLAM_LZ4_LIBRARY} OpenMP::OpenMP_CXX)
  find_path(CHAINSLAM_OPEN3D_INCLUDE open3d/geometry/PointCloud.h REQUIRED)
  find_library(CHAINSLAM_OPEN3D_LIBRARY Open3D REQUIRED)
  find_library(CHAINSLAM_FMT_LIBRARY fmt REQUIRED)
  chainslam_peer_library(open3d "${suffix}" "${flags}" INCLUDES ${CHAINSLAM_OPEN3D_INCLUDE}
                         DEFINITIONS EIGEN_MAX_ALIGN_BYTES=16
                         LIBRARIES ${CHAINSLAM_OPEN3D_LIBRARY} ${CHAINSLAM_FMT_LIBRARY} OpenMP::OpenMP_CXX)
endfunction()

# KISS-Matcher and TEASER++, which share pmc.
function(chainslam_clique_peers suffix flags kiss teaser)
  find_package(OpenMP REQUIRED)
  chainslam_peer_path(pmc CHAINSLAM_PEER_PMC pmc_lib.cpp)
  if(NOT pmc)
    message(FATAL_ERROR "KISS-Matcher and TEASER++ need CHAINSLAM_PEER_PMC, too")
  endif()
  file(GLOB pmc_sources ${pmc}/pmc_*.cpp ${pmc}/pmcx_*.cpp)
  list(FILTER pmc_sources EXCLUDE REGEX "driver")
  add_library(chainslam_pmc${suffix} STATIC EXCLUDE_FROM_ALL ${pmc_sources})
  target_include_directories(chainslam_pmc${suffix} SYSTEM PUBLIC ${pmc}/include ${pmc}/include/pmc ${pmc})
  target_compile_options(chainslam_pmc${suffix} PRIVATE ${flags} -w)
  target_link_libraries(chainslam_pmc${suffix} PUBLIC OpenMP::OpenMP_CXX)
  if(teaser)
    chainslam_peer_library(teaser "${suffix}" "${flags}" INCLUDES ${teaser}/teaser/include
                           SOURCES ${teaser}/teaser/src/registration.cc ${teaser}/teaser/src/graph.cc
                           LIBRARIES chainslam_pmc${suffix} OpenMP::OpenMP_CXX)
  endif()
  if(kiss)
    chainslam_peer_path(robin CHAINSLAM_PEER_ROBIN include/robin/robin.hpp)
    chainslam_peer_path(xenium CHAINSLAM_PEER_XENIUM xenium/ramalhete_queue.hpp)
    if(NOT robin OR NOT xenium)
      message(FATAL_ERROR "KISS-Matcher needs CHAINSLAM_PEER_ROBIN and CHAINSLAM_PEER_XENIUM, too")
    endif()
    find_package(TBB REQUIRED)
    find_library(CHAINSLAM_LZ4_LIBRARY lz4 REQUIRED)
    file(GLOB robin_sources ${robin}/src/*.cpp)
    set(core ${kiss}/cpp/kiss_matcher/core)
    chainslam_peer_library(kiss_matcher "${suffix}" "${flags}" INCLUDES ${core} ${robin}/include ${xenium}
      SOURCES ${core}/kiss_matcher/ROBINMatching.cpp ${core}/kiss_matcher/FasterPFH.cpp
              ${core}/kiss_matcher/KISSMatcher.cpp ${core}/kiss_matcher/GncSolver.cpp ${robin_sources}
      LIBRARIES chainslam_pmc${suffix} OpenMP::OpenMP_CXX TBB::tbb ${CHAINSLAM_LZ4_LIBRARY})
  endif()
endfunction()
