# The page of `loopwise report`: npm bundles web/ into one C++ file. Nothing is downloaded while configuring.

set(LOOPWISE_WITH_REPORT AUTO CACHE STRING
  "Bundle the page of `loopwise report` (needs npm): ON, OFF, or AUTO: if npm is there and works")
set_property(CACHE LOOPWISE_WITH_REPORT PROPERTY STRINGS AUTO ON OFF)

# Sets `result` to the source file that defines report_template().
function(loopwise_report_source result)
  set(${result} report_absent.cpp PARENT_SCOPE)
  set(mode AUTO)
  if(NOT LOOPWISE_WITH_REPORT STREQUAL "AUTO")
    if(NOT LOOPWISE_WITH_REPORT)
      return()
    endif()
    set(mode ON)
  endif()
  find_program(LOOPWISE_NPM npm DOC "Bundles the page of `loopwise report`")
  find_program(LOOPWISE_NODE NAMES node nodejs DOC "Runs the bundler of the page of `loopwise report`")
  mark_as_advanced(LOOPWISE_NPM LOOPWISE_NODE)
  if(NOT LOOPWISE_NPM OR NOT LOOPWISE_NODE)
    set(why "npm and node are not installed (Debian: nodejs, npm): `loopwise report` will not be able to write pages")
    if(mode STREQUAL "AUTO")
      message(STATUS "LOOPWISE_WITH_REPORT: ${why}")
      return()
    endif()
    message(FATAL_ERROR "LOOPWISE_WITH_REPORT=${LOOPWISE_WITH_REPORT}: ${why}")
  endif()
  set(web ${PROJECT_SOURCE_DIR}/web)
  set(folder ${PROJECT_BINARY_DIR}/web)
  set(output ${folder}/report_template.cpp)
  # GLOB suffices: a new source of the page is imported by another one, which changes.
  file(GLOB sources CONFIGURE_DEPENDS ${web}/src/*)
  # If only the option changes, the page has to be bundled again.
  file(CONFIGURE OUTPUT ${folder}/mode.txt CONTENT "${mode}\n")
  add_custom_command(
    OUTPUT ${output}
    COMMAND ${CMAKE_COMMAND} -DWEB=${web} -DOUT=${folder} -DNPM=${LOOPWISE_NPM} -DNODE=${LOOPWISE_NODE}
            -DMODE=${mode} -DABSENT=${PROJECT_SOURCE_DIR}/src/evaluation/report_absent.cpp
            -P ${PROJECT_SOURCE_DIR}/cmake/bundle_report.cmake
    DEPENDS ${sources} ${web}/build.mjs ${web}/package.json ${web}/package-lock.json ${web}/.npmrc ${folder}/mode.txt
            ${PROJECT_SOURCE_DIR}/cmake/bundle_report.cmake
    COMMENT "Bundling the page of `loopwise report`"
    VERBATIM)
  set(${result} ${output} PARENT_SCOPE)
endfunction()
