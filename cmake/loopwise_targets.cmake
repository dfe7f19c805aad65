# How a Loopwise component is declared, compiled, exported and found again. One component per folder of src/.

set(LOOPWISE_CMAKE_DIR ${CMAKE_INSTALL_LIBDIR}/cmake/loopwise)
set_property(GLOBAL PROPERTY LOOPWISE_COMPONENTS "")

# Flags of this build alone: linked as $<BUILD_INTERFACE:...>, so that they are never exported.
add_library(loopwise_build_flags INTERFACE)
target_compile_options(loopwise_build_flags INTERFACE -Wall -Wextra -Wshadow -Wconversion)
if(LOOPWISE_WARNINGS_AS_ERRORS)
  target_compile_options(loopwise_build_flags INTERFACE -Werror)
endif()
if(LOOPWISE_SANITIZE)
  target_compile_options(loopwise_build_flags INTERFACE -fsanitize=${LOOPWISE_SANITIZE} -fno-omit-frame-pointer -g)
  target_link_options(loopwise_build_flags INTERFACE -fsanitize=${LOOPWISE_SANITIZE})
  # Instrumented code confuses this analysis of gcc's: it warns of the standard library itself.
  target_compile_options(loopwise_build_flags INTERFACE -Wno-maybe-uninitialized)
  if(LOOPWISE_SANITIZE MATCHES "address")
    # Under this sanitizer Eigen would align memory by hand, but the libraries that we share matrices with (PCL) were
    # built without: malloc is aligned well enough in either case, so all may use it.
    target_compile_definitions(loopwise_build_flags INTERFACE EIGEN_MALLOC_ALREADY_ALIGNED=1)
  endif()
  if(LOOPWISE_SANITIZE MATCHES "undefined")
    target_compile_options(loopwise_build_flags INTERFACE -fno-sanitize-recover=undefined)
  endif()
endif()

# loopwise_add_component(NAME SOURCES a.cpp b.cpp
#   [PUBLIC targets...]    Loopwise components and libraries that its headers need
#   [PRIVATE targets...]   libraries that only its sources need
#   [PACKAGES call...]     find_dependency argument lists that a user of the installed component needs, one string each)
function(loopwise_add_component name)
  cmake_parse_arguments(ARG "" "" "SOURCES;PUBLIC;PRIVATE;PACKAGES" ${ARGN})
  set(target loopwise_${name})
  add_library(${target} ${ARG_SOURCES})
  add_library(loopwise::${name} ALIAS ${target})
  set_target_properties(${target} PROPERTIES EXPORT_NAME ${name} POSITION_INDEPENDENT_CODE ON
                        VERSION ${PROJECT_VERSION} SOVERSION ${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR})
  target_compile_features(${target} PUBLIC cxx_std_17)
  target_include_directories(${target} PUBLIC
    $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/include> $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>)
  target_link_libraries(${target} PUBLIC ${ARG_PUBLIC}
                        PRIVATE ${ARG_PRIVATE} $<BUILD_INTERFACE:loopwise_build_flags>)

  install(TARGETS ${target} EXPORT loopwise-${name} ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR}
          LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR})
  install(EXPORT loopwise-${name} NAMESPACE loopwise:: FILE loopwise-${name}.cmake DESTINATION ${LOOPWISE_CMAKE_DIR})
  if(EXISTS ${PROJECT_SOURCE_DIR}/include/loopwise/${name})
    install(DIRECTORY ${PROJECT_SOURCE_DIR}/include/loopwise/${name} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/loopwise)
  endif()

  # What the package configuration needs to bring the component back: its packages, then its Loopwise parts.
  set(parts)
  foreach(dependency IN LISTS ARG_PUBLIC ARG_PRIVATE)
    if(dependency MATCHES "^loopwise::(.+)$")
      list(APPEND parts ${CMAKE_MATCH_1})
    endif()
  endforeach()
  set_property(GLOBAL APPEND PROPERTY LOOPWISE_COMPONENTS ${name})
  set_property(GLOBAL PROPERTY LOOPWISE_${name}_PARTS "${parts}")
  set_property(GLOBAL PROPERTY LOOPWISE_${name}_PACKAGES "${ARG_PACKAGES}")
endfunction()

# Installs loopwiseConfig.cmake: find_package(loopwise CONFIG COMPONENTS optimization) brings one component and
# what it stands on; without COMPONENTS all that were built, and loopwise::loopwise.
function(loopwise_install_package)
  include(CMakePackageConfigHelpers)
  get_property(components GLOBAL PROPERTY LOOPWISE_COMPONENTS)
  set(LOOPWISE_COMPONENT_TABLE "")
  foreach(component IN LISTS components)
    get_property(parts GLOBAL PROPERTY LOOPWISE_${component}_PARTS)
    get_property(packages GLOBAL PROPERTY LOOPWISE_${component}_PACKAGES)
    string(APPEND LOOPWISE_COMPONENT_TABLE "set(_loopwise_${component}_parts ${parts})\n")
    set(quoted "")
    foreach(package IN LISTS packages)
      string(APPEND quoted " \"${package}\"")
    endforeach()
    string(APPEND LOOPWISE_COMPONENT_TABLE "set(_loopwise_${component}_packages${quoted})\n")
  endforeach()
  string(REPLACE ";" " " LOOPWISE_COMPONENT_NAMES "${components}")
  configure_package_config_file(${PROJECT_SOURCE_DIR}/cmake/loopwiseConfig.cmake.in
    ${PROJECT_BINARY_DIR}/loopwiseConfig.cmake INSTALL_DESTINATION ${LOOPWISE_CMAKE_DIR})
  write_basic_package_version_file(${PROJECT_BINARY_DIR}/loopwiseConfigVersion.cmake COMPATIBILITY SameMinorVersion)
  install(FILES ${PROJECT_BINARY_DIR}/loopwiseConfig.cmake ${PROJECT_BINARY_DIR}/loopwiseConfigVersion.cmake
                ${PROJECT_SOURCE_DIR}/cmake/FindCHOLMOD.cmake ${PROJECT_SOURCE_DIR}/cmake/FindPCLFeatures.cmake
                ${PROJECT_SOURCE_DIR}/cmake/FindRosbagStorage.cmake ${PROJECT_SOURCE_DIR}/cmake/FindLibZip.cmake
          DESTINATION ${LOOPWISE_CMAKE_DIR})
endfunction()
