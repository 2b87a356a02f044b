# The peers of rooms cloud, features and registration: one adapter each, compiled once a column with the flags of the
# bench, in a library of its own that carries the definition CHAINSLAM_PEER_<NAME>. Benches call them behind it.

set(CHAINSLAM_PEER_SMALL_GICP "" CACHE PATH "Sources of small_gicp, to be timed against")

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

# chainslam_peer_library(NAME SUFFIX FLAGS INCLUDES... [-- SOURCES...]): peers/NAME.cpp and the peer's own sources, which
# are not held to our warnings.
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
endfunction()
