# Finds the four libraries of PCL that the reference registrar uses: target PCLFeatures::PCLFeatures.
# PCL's own package brings VTK and with it MPI and Qt into every project that asks for any part of PCL.
# GLOB, newest first: the folder carries the version, as in pcl-1.13.
file(GLOB _pcl_folders LIST_DIRECTORIES TRUE /usr/include/pcl-1.* /usr/local/include/pcl-1.*)
list(SORT _pcl_folders COMPARE NATURAL ORDER DESCENDING)
find_path(PCLFeatures_INCLUDE_DIR pcl/features/fpfh.h HINTS ${PCL_ROOT} ${_pcl_folders})
find_path(PCLFeatures_BOOST_INCLUDE_DIR boost/version.hpp)
find_path(PCLFeatures_FLANN_INCLUDE_DIR flann/flann.hpp)
set(_pcl_libraries)
foreach(_pcl_part features search kdtree common)
  find_library(PCLFeatures_${_pcl_part}_LIBRARY pcl_${_pcl_part} HINTS ${PCL_ROOT})
  list(APPEND _pcl_libraries PCLFeatures_${_pcl_part}_LIBRARY)
endforeach()
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(PCLFeatures REQUIRED_VARS
  ${_pcl_libraries} PCLFeatures_INCLUDE_DIR PCLFeatures_BOOST_INCLUDE_DIR PCLFeatures_FLANN_INCLUDE_DIR)
set(PCLFeatures_LIBRARIES)
foreach(_pcl_library IN LISTS _pcl_libraries)
  list(APPEND PCLFeatures_LIBRARIES ${${_pcl_library}})
endforeach()
if(PCLFeatures_FOUND AND NOT TARGET PCLFeatures::PCLFeatures)
  add_library(PCLFeatures::PCLFeatures INTERFACE IMPORTED)
  target_link_libraries(PCLFeatures::PCLFeatures INTERFACE ${PCLFeatures_LIBRARIES})
  target_include_directories(PCLFeatures::PCLFeatures SYSTEM INTERFACE
    ${PCLFeatures_INCLUDE_DIR} ${PCLFeatures_BOOST_INCLUDE_DIR} ${PCLFeatures_FLANN_INCLUDE_DIR})
endif()
mark_as_advanced(${_pcl_libraries} PCLFeatures_INCLUDE_DIR PCLFeatures_BOOST_INCLUDE_DIR
                 PCLFeatures_FLANN_INCLUDE_DIR)
