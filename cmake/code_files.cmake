# Sets `result` to the files under ROOT that are compiled into these components. MODE may be CONFIGURE_DEPENDS in the
# configuration of a project.
function(loopwise_code_files result root mode)
  set(all "")
  foreach(component IN LISTS ARGN)
    file(GLOB_RECURSE files LIST_DIRECTORIES false RELATIVE ${root} ${mode}
         ${root}/src/${component}/*.cpp ${root}/src/${component}/*.hpp ${root}/src/${component}/*.inc
         ${root}/include/loopwise/${component}/*.hpp ${root}/include/loopwise/${component}/*.inc)
    list(SORT files)
    list(APPEND all ${files})
  endforeach()
  set(${result} ${all} PARENT_SCOPE)
endfunction()
