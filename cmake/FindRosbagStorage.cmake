# Finds the library that reads ROS 1 bags and the includes of its headers: target RosbagStorage::RosbagStorage. The
# package's own CMake files are not used: through pluginlib they bring ament, which runs the first python3 of the path.
# If that lacks a module, ament stops the configuration, even with QUIET.
set(_rosbag_variables)
foreach(_rosbag_header rosbag/bag.h ros/time.h roslz4/lz4s.h console_bridge/console.h pluginlib/class_loader.hpp
                       class_loader/class_loader.hpp boost/format.hpp bzlib.h)
  string(MAKE_C_IDENTIFIER "RosbagStorage_${_rosbag_header}_INCLUDE_DIR" _rosbag_variable)
  # Debian has separate folders for some of them.
  get_filename_component(_rosbag_folder ${_rosbag_header} DIRECTORY)
  find_path(${_rosbag_variable} ${_rosbag_header} PATH_SUFFIXES ${_rosbag_folder})
  list(APPEND _rosbag_variables ${_rosbag_variable})
endforeach()
set(_rosbag_includes ${_rosbag_variables})
set(_rosbag_libraries)
foreach(_rosbag_name rosbag_storage roscpp_serialization rostime cpp_common roslz4 bz2)
  find_library(RosbagStorage_${_rosbag_name}_LIBRARY ${_rosbag_name})
  list(APPEND _rosbag_variables RosbagStorage_${_rosbag_name}_LIBRARY)
  list(APPEND _rosbag_libraries RosbagStorage_${_rosbag_name}_LIBRARY)
endforeach()
# Only newer versions of pluginlib include it.
set(_rosbag_optional)
foreach(_rosbag_name rcutils rcpputils ament_index_cpp)
  find_path(RosbagStorage_${_rosbag_name}_INCLUDE_DIR NAMES ${_rosbag_name}/visibility_control.h
            ${_rosbag_name}/visibility_control.hpp ${_rosbag_name}/filesystem_helper.hpp
            PATH_SUFFIXES ${_rosbag_name})
  if(RosbagStorage_${_rosbag_name}_INCLUDE_DIR)
    list(APPEND _rosbag_optional RosbagStorage_${_rosbag_name}_INCLUDE_DIR)
  endif()
  mark_as_advanced(RosbagStorage_${_rosbag_name}_INCLUDE_DIR)
endforeach()
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(RosbagStorage REQUIRED_VARS ${_rosbag_variables})
set(RosbagStorage_LIBRARIES)
foreach(_rosbag_variable IN LISTS _rosbag_libraries)
  list(APPEND RosbagStorage_LIBRARIES ${${_rosbag_variable}})
endforeach()
if(RosbagStorage_FOUND AND NOT TARGET RosbagStorage::RosbagStorage)
  add_library(RosbagStorage::RosbagStorage INTERFACE IMPORTED)
  foreach(_rosbag_variable IN LISTS _rosbag_includes _rosbag_optional)
    target_include_directories(RosbagStorage::RosbagStorage SYSTEM INTERFACE ${${_rosbag_variable}})
  endforeach()
  target_link_libraries(RosbagStorage::RosbagStorage INTERFACE ${RosbagStorage_LIBRARIES})
endif()
mark_as_advanced(${_rosbag_variables})
