# Functions that declare, compile, export and find a Loopwise component. One component per folder of src/.

set(LOOPWISE_CMAKE_DIR ${CMAKE_INSTALL_LIBDIR}/cmake/loopwise)
set_property(GLOBAL PROPERTY LOOPWISE_COMPONENTS "")

if(LOOPWISE_BUILD_FUZZERS)
  if(NOT CMAKE_CXX_COMPILER_ID MATCHES "Clang")
    message(FATAL_ERROR "LOOPWISE_BUILD_FUZZERS needs clang, whose libFuzzer drives the targets; the compiler is "
      "${CMAKE_CXX_COMPILER_ID}. Use scripts/fuzz, or configure anew with -DCMAKE_CXX_COMPILER=clang++")
  endif()
  # The targets add the fuzzer itself. A cast beyond the range of an integer is undefined, but not part of the check
  # `undefined`.
  set(LOOPWISE_SANITIZE address,undefined,float-cast-overflow,fuzzer-no-link)
  add_compile_definitions(_GLIBCXX_ASSERTIONS)
endif()

# Flags of this build, linked as $<BUILD_INTERFACE:...> so that they are never exported.
add_library(loopwise_build_flags INTERFACE)
# Without fused multiply-adds, two expressions of one distance round alike, whatever processor it is built for.
target_compile_options(loopwise_build_flags INTERFACE -Wall -Wextra -Wshadow -Wconversion -ffp-contract=off)
if(LOOPWISE_WARNINGS_AS_ERRORS)
  target_compile_options(loopwise_build_flags INTERFACE -Werror)
endif()
if(LOOPWISE_SANITIZE)
  target_compile_options(loopwise_build_flags INTERFACE -fsanitize=${LOOPWISE_SANITIZE} -fno-omit-frame-pointer -g)
  target_link_options(loopwise_build_flags INTERFACE -fsanitize=${LOOPWISE_SANITIZE})
  # In instrumented code, this analysis of gcc has false warnings about the standard library.
  target_compile_options(loopwise_build_flags INTERFACE $<$<CXX_COMPILER_ID:GNU>:-Wno-maybe-uninitialized>)
  if(LOOPWISE_SANITIZE MATCHES "address")
    # With this sanitizer, Eigen would align memory by hand. PCL, with which matrices are shared, is
    # built without it. The alignment of malloc suffices in both cases, so all code uses malloc.
    target_compile_definitions(loopwise_build_flags INTERFACE EIGEN_MALLOC_ALREADY_ALIGNED=1)
  endif()
  if(LOOPWISE_SANITIZE MATCHES "undefined")
    target_compile_options(loopwise_build_flags INTERFACE -fno-sanitize-recover=undefined)
    if(LOOPWISE_SANITIZE MATCHES "float-cast-overflow")
      target_compile_options(loopwise_build_flags INTERFACE -fno-sanitize-recover=float-cast-overflow)
    endif()
  endif()
endif()

# Components that read input from outside.
set(LOOPWISE_READERS "^(core|io|engine|online|replay|evaluation|distributed|training|study)$")
set(LOOPWISE_READER_FLAGS "")
if(LOOPWISE_HARDENING AND NOT LOOPWISE_SANITIZE)
  include(CheckCXXCompilerFlag)
  include(CheckLinkerFlag)
  # Checks sizes that the compiler knows in functions of the C library that copy or format. Needs optimisation.
  target_compile_options(loopwise_build_flags INTERFACE
    "$<$<CONFIG:Release,RelWithDebInfo,MinSizeRel>:-U_FORTIFY_SOURCE;-D_FORTIFY_SOURCE=2>")
  foreach(flag -fstack-clash-protection -fcf-protection -mbranch-protection=standard)
    string(MAKE_C_IDENTIFIER "LOOPWISE_COMPILER_TAKES${flag}" takes)
    check_cxx_compiler_flag(${flag} ${takes})
    if(${takes})
      target_compile_options(loopwise_build_flags INTERFACE ${flag})
    endif()
  endforeach()
  # Only readers have stack protection. Nearly all functions of other components have a small matrix on the stack, and
  # the protection would slow them down.
  check_cxx_compiler_flag(-fstack-protector-strong LOOPWISE_COMPILER_PROTECTS_STACK)
  if(LOOPWISE_COMPILER_PROTECTS_STACK)
    set(LOOPWISE_READER_FLAGS -fstack-protector-strong)
  endif()
  include(CheckPIESupported)
  check_pie_supported()
  check_linker_flag(CXX "LINKER:-z,relro,-z,now" LOOPWISE_LINKER_TAKES_RELRO)
  if(LOOPWISE_LINKER_TAKES_RELRO)
    target_link_options(loopwise_build_flags INTERFACE "LINKER:-z,relro,-z,now")
  endif()
endif()

# Shared libraries export the symbols of public headers (LOOPWISE_EXPORT), and no symbols of libraries compiled in.
set(LOOPWISE_VERSION_SCRIPT "")
if(BUILD_SHARED_LIBS)
  include(CheckLinkerFlag)
  set(script ${PROJECT_SOURCE_DIR}/cmake/loopwise.map)
  check_linker_flag(CXX "LINKER:--version-script=${script}" LOOPWISE_LINKER_TAKES_VERSION_SCRIPT)
  if(LOOPWISE_LINKER_TAKES_VERSION_SCRIPT)
    set(LOOPWISE_VERSION_SCRIPT ${script})
  endif()
  if(NOT DEFINED CMAKE_INSTALL_RPATH)
    # Programs and libraries find the libraries of their own installation in any folder.
    file(RELATIVE_PATH to_libraries /${CMAKE_INSTALL_BINDIR} /${CMAKE_INSTALL_LIBDIR})
    set(CMAKE_INSTALL_RPATH "$ORIGIN;$ORIGIN/${to_libraries}")
  endif()
endif()

# Compile and link flags of the programs.
function(loopwise_harden_program target)
  target_compile_options(${target} PRIVATE ${LOOPWISE_READER_FLAGS})
  if(LOOPWISE_HARDENING)
    set_target_properties(${target} PROPERTIES POSITION_INDEPENDENT_CODE ON)
  endif()
endfunction()

# loopwise_find_optional(OPTION PACKAGE HINT RESULT [VERSION])
# Sets RESULT to whether the option is on and the package is found. ON without the package is an error.
function(loopwise_find_optional option package hint result)
  set(${result} FALSE PARENT_SCOPE)
  if(NOT ${option} STREQUAL "AUTO" AND NOT ${option})
    return()
  endif()
  find_package(${package} ${ARGN} QUIET)
  if(${package}_FOUND)
    set(${result} TRUE PARENT_SCOPE)
  elseif(${option} STREQUAL "AUTO")
    message(STATUS "${option}: ${hint}")
  else()
    message(FATAL_ERROR "${option}=${${option}}: ${hint}")
  endif()
endfunction()

# loopwise_add_component(NAME SOURCES a.cpp b.cpp
#   [PUBLIC targets...]    Loopwise components and libraries that its headers need
#   [PRIVATE targets...]   libraries that only its sources need
#   [PACKAGES call...]     find_dependency argument lists that a user of the installed component needs, one string each
#   [STATIC_PACKAGES call...]     the same, needed only for linking a static component
#   [MODULES name...]      for pkg-config: modules that its headers need
function(loopwise_add_component name)
  set(lists SOURCES PUBLIC PRIVATE PACKAGES STATIC_PACKAGES MODULES)
  cmake_parse_arguments(ARG "" "" "${lists}" ${ARGN})
  set(target loopwise_${name})
  add_library(${target} ${ARG_SOURCES})
  add_library(loopwise::${name} ALIAS ${target})
  # Compatible within one minor version before 1.0, see docs/building.md.
  if(LOOPWISE_BUILD_FUZZERS)
    # Other components are not instrumented, so fuzzers are faster and count only the edges of readers.
    set(plain ${ARG_SOURCES})
    if(name MATCHES "${LOOPWISE_READERS}")
      set(plain)
    elseif(name STREQUAL "prioritization")
      list(REMOVE_ITEM plain tensor_file.cpp effect_network.cpp gnn.cpp)
    endif()
    set_source_files_properties(${plain} PROPERTIES COMPILE_OPTIONS "-fno-sanitize=all;-O0")
  endif()
  set_target_properties(${target} PROPERTIES EXPORT_NAME ${name} POSITION_INDEPENDENT_CODE ON
                        VERSION ${PROJECT_VERSION} SOVERSION ${PROJECT_VERSION_MAJOR}.${PROJECT_VERSION_MINOR})
  set_target_properties(${target} PROPERTIES UNITY_BUILD ${LOOPWISE_UNITY_BUILD} UNITY_BUILD_BATCH_SIZE 8)
  if(LOOPWISE_UNITY_BUILD)
    # Types of one source in members of a class that only this source defines: correct, but no longer in the main file.
    target_compile_options(${target} PRIVATE $<$<CXX_COMPILER_ID:GNU>:-Wno-subobject-linkage>)
  endif()
  foreach(source IN LISTS ARG_SOURCES)
    if(source MATCHES "_kernels\\.cpp$")  # one file per instruction set defines the same names
      set_source_files_properties(${source} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
    endif()
  endforeach()
  target_compile_features(${target} PUBLIC cxx_std_17)
  target_include_directories(${target} PUBLIC
    $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/include> $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>)
  target_link_libraries(${target} PUBLIC ${ARG_PUBLIC}
                        PRIVATE ${ARG_PRIVATE} $<BUILD_INTERFACE:loopwise_build_flags>)
  if(name MATCHES "${LOOPWISE_READERS}")
    target_compile_options(${target} PRIVATE ${LOOPWISE_READER_FLAGS})
  elseif(name STREQUAL "prioritization")  # files of weights
    set_property(SOURCE tensor_file.cpp effect_network.cpp gnn.cpp APPEND PROPERTY COMPILE_OPTIONS ${LOOPWISE_READER_FLAGS})
  endif()
  if(BUILD_SHARED_LIBS)
    set_target_properties(${target} PROPERTIES CXX_VISIBILITY_PRESET hidden VISIBILITY_INLINES_HIDDEN ON)
    target_compile_definitions(${target} PUBLIC LOOPWISE_SHARED)
    if(LOOPWISE_VERSION_SCRIPT)
      target_link_options(${target} PRIVATE "LINKER:--version-script=${LOOPWISE_VERSION_SCRIPT}")
      set_property(TARGET ${target} APPEND PROPERTY LINK_DEPENDS ${LOOPWISE_VERSION_SCRIPT})
    endif()
  endif()

  install(TARGETS ${target} EXPORT loopwise-${name}
          ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT loopwise_development
          LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT loopwise_runtime
                  NAMELINK_COMPONENT loopwise_development)
  install(EXPORT loopwise-${name} NAMESPACE loopwise:: FILE loopwise-${name}.cmake DESTINATION ${LOOPWISE_CMAKE_DIR}
          COMPONENT loopwise_development)
  if(EXISTS ${PROJECT_SOURCE_DIR}/include/loopwise/${name})
    install(DIRECTORY ${PROJECT_SOURCE_DIR}/include/loopwise/${name} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/loopwise
            COMPONENT loopwise_development FILES_MATCHING PATTERN "*.hpp")
  endif()

  # Dependencies for the package configuration: packages first, then components of Loopwise.
  set(parts)
  foreach(dependency IN LISTS ARG_PUBLIC ARG_PRIVATE)
    if(dependency MATCHES "^loopwise::(.+)$")
      list(APPEND parts ${CMAKE_MATCH_1})
    endif()
  endforeach()
  set(packages ${ARG_PACKAGES})
  if(NOT BUILD_SHARED_LIBS)
    list(APPEND packages ${ARG_STATIC_PACKAGES})
  endif()
  set_property(GLOBAL APPEND PROPERTY LOOPWISE_COMPONENTS ${name})
  set_property(GLOBAL PROPERTY LOOPWISE_${name}_PARTS "${parts}")
  set_property(GLOBAL PROPERTY LOOPWISE_${name}_PACKAGES "${packages}")
  loopwise_add_pkg_config(${name} "${ARG_PUBLIC}" "${ARG_PRIVATE}" "${ARG_MODULES}")
endfunction()

# Sets `result` to the files and flags that a library of another package links: its own, and those below it.
function(loopwise_linked_files result library)
  set(found)
  if(NOT TARGET "${library}")
    if(NOT library MATCHES "^\\$<")  # only in this build
      set(found ${library})
    endif()
    set(${result} ${found} PARENT_SCOPE)
    return()
  endif()
  get_target_property(type ${library} TYPE)
  if(NOT type STREQUAL "INTERFACE_LIBRARY")
    get_target_property(found ${library} LOCATION)
  endif()
  get_target_property(below ${library} INTERFACE_LINK_LIBRARIES)
  if(below)
    foreach(dependency IN LISTS below)
      string(REGEX REPLACE "^\\$<LINK_ONLY:(.*)>$" "\\1" dependency "${dependency}")
      loopwise_linked_files(files "${dependency}")
      list(APPEND found ${files})
    endforeach()
  endif()
  set(${result} ${found} PARENT_SCOPE)
endfunction()

# Installs loopwise-NAME.pc. Private dependencies are for static libraries, with `pkg-config --static`. Shared libraries
# record theirs, and pkg-config would ask for development files of private ones in any case.
function(loopwise_add_pkg_config name public private modules)
  set(PC_NAME loopwise-${name})
  set(PC_DESCRIPTION "${PROJECT_DESCRIPTION}: ${name}")
  set(PC_LIBS "-L\${libdir} -lloopwise_${name}")
  set(public_modules)
  set(private_modules)
  foreach(visibility public private)
    foreach(dependency IN LISTS ${visibility})
      if(dependency MATCHES "^loopwise::(.+)$")
        list(APPEND ${visibility}_modules "loopwise-${CMAKE_MATCH_1} = ${PROJECT_VERSION}")
      endif()
    endforeach()
  endforeach()
  string(JOIN ", " PC_REQUIRES ${public_modules} ${modules})
  if(BUILD_SHARED_LIBS)
    loopwise_install_pkg_config()
    return()
  endif()
  string(JOIN ", " PC_REQUIRES_PRIVATE ${private_modules})
  set(libraries)
  foreach(dependency IN LISTS public private)
    if(NOT dependency MATCHES "^loopwise::")
      loopwise_linked_files(files "${dependency}")
      list(APPEND libraries ${files})
    endif()
  endforeach()
  set(flags)
  foreach(library IN LISTS libraries)
    if(IS_ABSOLUTE "${library}")
      get_filename_component(folder ${library} DIRECTORY)
      get_filename_component(library ${library} NAME_WE)
      string(REGEX REPLACE "^lib" "" library ${library})
      if(NOT folder IN_LIST CMAKE_CXX_IMPLICIT_LINK_DIRECTORIES)
        list(APPEND flags -L${folder})
      endif()
    endif()
    if(NOT library MATCHES "^-")
      set(library -l${library})
    endif()
    list(APPEND flags ${library})
  endforeach()
  list(REMOVE_DUPLICATES flags)
  string(JOIN " " PC_LIBS_PRIVATE ${flags})
  loopwise_install_pkg_config()
endfunction()

# Uses the caller's PC_* variables.
function(loopwise_install_pkg_config)
  set(folder ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
  if(IS_ABSOLUTE "${folder}")
    set(PC_PREFIX ${CMAKE_INSTALL_PREFIX})
  else()
    # Valid in any folder to which the tree is installed or moved.
    file(RELATIVE_PATH up /${folder} /)
    string(REGEX REPLACE "/$" "" up "${up}")
    set(PC_PREFIX "\${pcfiledir}/${up}")
  endif()
  foreach(kind INCLUDEDIR LIBDIR)
    if(IS_ABSOLUTE "${CMAKE_INSTALL_${kind}}")
      set(PC_${kind} ${CMAKE_INSTALL_${kind}})
    else()
      set(PC_${kind} "\${prefix}/${CMAKE_INSTALL_${kind}}")
    endif()
  endforeach()
  set(PC_CFLAGS "-I\${includedir}")
  if(BUILD_SHARED_LIBS)
    string(APPEND PC_CFLAGS " -DLOOPWISE_SHARED")
  endif()
  configure_file(${PROJECT_SOURCE_DIR}/cmake/loopwise.pc.in ${PROJECT_BINARY_DIR}/pkgconfig/${PC_NAME}.pc @ONLY)
  install(FILES ${PROJECT_BINARY_DIR}/pkgconfig/${PC_NAME}.pc DESTINATION ${folder} COMPONENT loopwise_development)
endfunction()

# Installs loopwiseConfig.cmake: find_package(loopwise CONFIG COMPONENTS optimization) finds one component and its
# dependencies; without COMPONENTS it finds all built ones and loopwise::loopwise. loopwise.pc also has all of them.
function(loopwise_install_package)
  include(CMakePackageConfigHelpers)
  get_property(components GLOBAL PROPERTY LOOPWISE_COMPONENTS)
  set(LOOPWISE_COMPONENT_TABLE "")
  set(requires)
  foreach(component IN LISTS components)
    get_property(parts GLOBAL PROPERTY LOOPWISE_${component}_PARTS)
    get_property(packages GLOBAL PROPERTY LOOPWISE_${component}_PACKAGES)
    string(APPEND LOOPWISE_COMPONENT_TABLE "set(_loopwise_${component}_parts ${parts})\n")
    set(quoted "")
    foreach(package IN LISTS packages)
      string(APPEND quoted " \"${package}\"")
    endforeach()
    string(APPEND LOOPWISE_COMPONENT_TABLE "set(_loopwise_${component}_packages${quoted})\n")
    list(PREPEND requires "loopwise-${component} = ${PROJECT_VERSION}")
  endforeach()
  string(REPLACE ";" " " LOOPWISE_COMPONENT_NAMES "${components}")
  set(LOOPWISE_DATA_DIR ${CMAKE_INSTALL_DATADIR}/loopwise)
  configure_package_config_file(${PROJECT_SOURCE_DIR}/cmake/loopwiseConfig.cmake.in
    ${PROJECT_BINARY_DIR}/loopwiseConfig.cmake INSTALL_DESTINATION ${LOOPWISE_CMAKE_DIR}
    PATH_VARS LOOPWISE_DATA_DIR)
  write_basic_package_version_file(${PROJECT_BINARY_DIR}/loopwiseConfigVersion.cmake COMPATIBILITY SameMinorVersion)
  install(FILES ${PROJECT_BINARY_DIR}/loopwiseConfig.cmake ${PROJECT_BINARY_DIR}/loopwiseConfigVersion.cmake
                ${PROJECT_SOURCE_DIR}/cmake/FindCHOLMOD.cmake ${PROJECT_SOURCE_DIR}/cmake/FindPCLFeatures.cmake
                ${PROJECT_SOURCE_DIR}/cmake/FindRosbagStorage.cmake ${PROJECT_SOURCE_DIR}/cmake/FindRosbag2Libraries.cmake
                ${PROJECT_SOURCE_DIR}/cmake/FindLibZip.cmake
          DESTINATION ${LOOPWISE_CMAKE_DIR} COMPONENT loopwise_development)

  set(PC_NAME loopwise)
  set(PC_DESCRIPTION "${PROJECT_DESCRIPTION}")
  string(JOIN ", " PC_REQUIRES ${requires})
  loopwise_install_pkg_config()
endfunction()
