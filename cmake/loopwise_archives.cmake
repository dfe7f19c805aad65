# Optional forms of input: bags of ROS 1 and ROS 2, and zip archives.

set(LOOPWISE_WITH_ROSBAG AUTO CACHE STRING
  "Read ROS 1 bags (needs librosbag_storage): ON, OFF, or AUTO: if it is found")
set(LOOPWISE_WITH_ROSBAG2 AUTO CACHE STRING
  "Read ROS 2 bags (needs SQLite, zstd and lz4): ON, OFF, or AUTO: if they are found")
set(LOOPWISE_WITH_ZIP AUTO CACHE STRING "Read zip archives (needs libzip): ON, OFF, or AUTO: if it is found")
set_property(CACHE LOOPWISE_WITH_ROSBAG LOOPWISE_WITH_ROSBAG2 LOOPWISE_WITH_ZIP PROPERTY STRINGS AUTO ON OFF)
