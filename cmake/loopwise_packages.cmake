# Debian packages by CPack, see scripts/package: the shared libraries, the files for developers, and the programs.
set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME loopwise)
set(CPACK_PACKAGE_VENDOR "the Loopwise authors")
set(CPACK_PACKAGE_CONTACT "the Loopwise authors <authors@loopwise.invalid>")
set(CPACK_PACKAGE_VERSION ${PROJECT_VERSION})
set(CPACK_PACKAGE_CHECKSUM SHA256)
set(CPACK_STRIP_FILES ON)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_COMPONENTS_GROUPING IGNORE)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
# A snapshot sorts before its release: 0.1.0~dev
set(LOOPWISE_PACKAGE_SUFFIX "" CACHE STRING "Put behind the version of packages, for example ~dev20260801")
string(APPEND CPACK_PACKAGE_VERSION "${LOOPWISE_PACKAGE_SUFFIX}")
set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION ON)
set(CPACK_PRE_BUILD_SCRIPTS ${PROJECT_SOURCE_DIR}/cmake/compress_documents.cmake)

set(so_version ${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR})
set(components loopwise_development)
if(BUILD_SHARED_LIBS)
  list(PREPEND components loopwise_runtime)
endif()
if(LOOPWISE_BUILD_APPS)
  list(APPEND components loopwise_tools)
endif()
set(CPACK_COMPONENTS_ALL ${components})

set(CPACK_DEBIAN_LOOPWISE_RUNTIME_PACKAGE_NAME libloopwise${so_version})
set(CPACK_DEBIAN_LOOPWISE_RUNTIME_PACKAGE_SECTION libs)
set(CPACK_DEBIAN_LOOPWISE_RUNTIME_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_LOOPWISE_RUNTIME_PACKAGE_GENERATE_SHLIBS ON)
set(CPACK_COMPONENT_LOOPWISE_RUNTIME_DESCRIPTION "${PROJECT_DESCRIPTION} (shared libraries)
Loopwise decides which loop closures of a multi-robot lidar SLAM system are worth computing, computes them, and
keeps the map consistent.")

set(CPACK_DEBIAN_LOOPWISE_DEVELOPMENT_PACKAGE_NAME libloopwise-dev)
set(CPACK_DEBIAN_LOOPWISE_DEVELOPMENT_PACKAGE_SECTION libdevel)
# Includes of public headers. Static libraries also need the libraries that they were built with.
set(depends "libeigen3-dev, nlohmann-json3-dev (>= 3.9)")
if(BUILD_SHARED_LIBS)
  string(PREPEND depends "libloopwise${so_version} (= ${CPACK_PACKAGE_VERSION}), ")
else()
  string(APPEND depends ", libsuitesparse-dev")
  if(TARGET loopwise::simulation)
    string(APPEND depends ", libembree-dev, libtbb-dev")
  endif()
  if(TARGET loopwise::registration_pcl)
    string(APPEND depends ", libpcl-dev")
  endif()
endif()
set(CPACK_DEBIAN_LOOPWISE_DEVELOPMENT_PACKAGE_DEPENDS "${depends}")
set(CPACK_DEBIAN_LOOPWISE_DEVELOPMENT_PACKAGE_SUGGESTS "cmake, pkg-config, loopwise")
set(CPACK_COMPONENT_LOOPWISE_DEVELOPMENT_DESCRIPTION "${PROJECT_DESCRIPTION} (development)
Headers, CMake packages and pkg-config files of Loopwise, one component for each stage.")

set(CPACK_DEBIAN_LOOPWISE_TOOLS_PACKAGE_NAME loopwise)
set(CPACK_DEBIAN_LOOPWISE_TOOLS_PACKAGE_SECTION science)
set(CPACK_DEBIAN_LOOPWISE_TOOLS_PACKAGE_SHLIBDEPS ON)
if(BUILD_SHARED_LIBS)
  set(CPACK_DEBIAN_LOOPWISE_TOOLS_PACKAGE_DEPENDS "libloopwise${so_version} (= ${CPACK_PACKAGE_VERSION})")
endif()
set(CPACK_COMPONENT_LOOPWISE_TOOLS_DESCRIPTION "${PROJECT_DESCRIPTION}
Replays recorded missions of teams of robots, finds their loop closures in the order of their worth, optimises
pose graphs robustly, aligns scans, and judges and shows the results. With manual pages, completion for shells,
weights of networks and a sample mission.")

# The programs are linked to libraries of this build, which no installed package contains.
get_property(names GLOBAL PROPERTY LOOPWISE_COMPONENTS)
foreach(library IN LISTS names)
  list(APPEND CPACK_DEBIAN_PACKAGE_SHLIBDEPS_PRIVATE_DIRS ${PROJECT_BINARY_DIR}/src/${library})
endforeach()

# Each package states authors and licence of its code, also for code from headers of other projects.
if(LOOPWISE_WITH_GPL)
  set(LOOPWISE_BINARIES_LICENSE "BSD-3-Clause and GPL-2+")
  set(LOOPWISE_BINARIES_NOTE
" This build can call the supernodal factorisation of CHOLMOD (SuiteSparse), which is under the GPL, version 2 or later:
 who distributes these packages does so under those terms. The sources of Loopwise are BSD-3-Clause all the same; a build
 with -DLOOPWISE_WITH_GPL=OFF does not call it.")
else()
  set(LOOPWISE_BINARIES_LICENSE "BSD-3-Clause")
  set(LOOPWISE_BINARIES_NOTE
" This build (-DLOOPWISE_WITH_GPL=OFF) calls no part of CHOLMOD (SuiteSparse) that is under the GPL. The parts that it
 calls are under the LGPL, version 2.1 or later, and linked dynamically.")
endif()
file(READ ${PROJECT_SOURCE_DIR}/LICENSE license)
string(REGEX REPLACE "^[^\n]*\n\n[^\n]*\n\n" "" license "${license}")
string(REGEX REPLACE "\n\n" "\n.\n" license "${license}")
string(STRIP "${license}" license)
string(REPLACE "\n" "\n " LOOPWISE_LICENSE_TEXT " ${license}")
configure_file(${PROJECT_SOURCE_DIR}/cmake/debian_copyright.in ${PROJECT_BINARY_DIR}/debian/copyright @ONLY)

# Headers whose code is in the binaries, with the notices in their Debian packages.
set(notices "Notices of the libraries whose headers were compiled into these binaries.\n")
foreach(package libeigen3-dev nlohmann-json3-dev libcli11-dev libtbb-dev libpcl-dev libflann-dev)
  if(EXISTS /usr/share/doc/${package}/copyright)
    file(READ /usr/share/doc/${package}/copyright notice)
    string(APPEND notices "\n==== ${package}\n\n${notice}")
  endif()
endforeach()
file(CONFIGURE OUTPUT ${PROJECT_BINARY_DIR}/debian/NOTICES CONTENT "@notices@" @ONLY)

function(install_documents component package)
  # Only in packages: other installations have the LICENSE of the sources.
  install(FILES ${PROJECT_BINARY_DIR}/debian/copyright ${PROJECT_BINARY_DIR}/debian/NOTICES
                ${PROJECT_SOURCE_DIR}/CHANGELOG.md ${ARGN}
          DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/${package} COMPONENT ${component} EXCLUDE_FROM_ALL)
endfunction()
install_documents(loopwise_development libloopwise-dev)
install_documents(loopwise_tools loopwise ${PROJECT_SOURCE_DIR}/web/THIRD_PARTY.md)
if(BUILD_SHARED_LIBS)
  # A library contains the page of reports.
  install_documents(loopwise_runtime libloopwise${so_version} ${PROJECT_SOURCE_DIR}/web/THIRD_PARTY.md)
endif()
include(CPack)
