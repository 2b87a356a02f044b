# Included after the install rules: what `cpack` makes of them, a Debian package of headers, program and documentation.
# Headers alone (CHAINSLAM_BUILD_EXAMPLES and CHAINSLAM_COMPILED off) are a package for any architecture.
set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_VENDOR chainslam)
set(CPACK_PACKAGE_DESCRIPTION "Header-only C++20 library for multi-session LiDAR(-inertial) SLAM: nearest-neighbour search, ICP, LiDAR-inertial
odometry, factor graphs, loop closure; and the mapping program chainslam.
Headers, CMake and pkg-config files, program, pages and example programs.")
if(NOT CPACK_PACKAGE_CONTACT)  # -DCPACK_PACKAGE_CONTACT="NAME <ADDRESS>": who gives the package out
  set(CPACK_PACKAGE_CONTACT "chainslam maintainers <maintainers@chainslam.invalid>")
endif()
set(CPACK_STRIP_FILES ON)
set(CPACK_INSTALL_DEFAULT_DIRECTORY_PERMISSIONS
    OWNER_READ OWNER_WRITE OWNER_EXECUTE GROUP_READ GROUP_EXECUTE WORLD_READ WORLD_EXECUTE)

set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_COMPRESSION_TYPE xz)
set(CPACK_DEBIAN_PACKAGE_SECTION libdevel)
# What headers need: Eigen all of them, the others the header of the component of that name.
set(CPACK_DEBIAN_PACKAGE_RECOMMENDS "g++, libeigen3-dev (>= 3.4)")
set(CPACK_DEBIAN_PACKAGE_SUGGESTS "cmake (>= 3.25), pkg-config, libnanoflann-dev, libsuitesparse-dev, libzstd-dev, libxxhash-dev")
if(CHAINSLAM_BUILD_EXAMPLES)
  set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
  set(CPACK_DEBIAN_PACKAGE_DEPENDS libjs-three)  # which reports are written with
elseif(NOT CHAINSLAM_COMPILED)
  set(CPACK_DEBIAN_PACKAGE_ARCHITECTURE all)
endif()
include(CPack)
