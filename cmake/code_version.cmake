# Run at build time: writes the header OUTPUT with hashes of the library's sources under ROOT. What was computed by one
# version of the code is then never taken for another's.

# Sets `result` to the hash of all sources and headers of the components.
function(hash_components result)
  set(hashes "")
  foreach(component IN LISTS ARGN)
    file(GLOB_RECURSE files LIST_DIRECTORIES false RELATIVE ${ROOT}
         ${ROOT}/src/${component}/*.cpp ${ROOT}/src/${component}/*.hpp ${ROOT}/include/loopwise/${component}/*.hpp)
    list(SORT files)
    foreach(file IN LISTS files)
      file(SHA256 ${ROOT}/${file} hash)
      string(APPEND hashes "${file} ${hash}\n")
    endforeach()
  endforeach()
  string(SHA256 hash "${hashes}")
  string(SUBSTRING ${hash} 0 32 hash)
  set(${result} ${hash} PARENT_SCOPE)
endfunction()

hash_components(registration core features registration)
# Finished runs of studies hold figures that evaluation makes.
hash_components(replay core features registration io generation optimization prioritization engine pipeline evaluation)
file(WRITE ${OUTPUT} "#define LOOPWISE_REGISTRATION_CODE \"${registration}\"\n#define LOOPWISE_REPLAY_CODE \"${replay}\"\n")
