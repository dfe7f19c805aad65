# Optional forms of input: bags of ROS 1 and ROS 2, and zip archives.

set(LOOPWISE_WITH_ROSBAG AUTO CACHE STRING
  "Read ROS 1 bags (needs librosbag_storage): ON, OFF, or AUTO: if it is found")
set(LOOPWISE_WITH_ROSBAG2 AUTO CACHE STRING
  "Read ROS 2 bags (needs SQLite, zstd and lz4): ON, OFF, or AUTO: if they are found")
set(LOOPWISE_WITH_ZIP AUTO CACHE STRING "Read zip archives (needs libzip): ON, OFF, or AUTO: if it is found")
set_property(CACHE LOOPWISE_WITH_ROSBAG LOOPWISE_WITH_ROSBAG2 LOOPWISE_WITH_ZIP PROPERTY STRINGS AUTO ON OFF)

# Sets `result` to whether the option is on and the package is found. ON without the package is an error.
function(loopwise_find_optional option package hint result)
  set(${result} FALSE PARENT_SCOPE)
  if(NOT ${option} STREQUAL "AUTO" AND NOT ${option})
    return()
  endif()
  find_package(${package} QUIET)
  if(${package}_FOUND)
    set(${result} TRUE PARENT_SCOPE)
  elseif(${option} STREQUAL "AUTO")
    message(STATUS "${option}: ${hint}")
  else()
    message(FATAL_ERROR "${option}=${${option}}: ${hint}")
  endif()
endfunction()
