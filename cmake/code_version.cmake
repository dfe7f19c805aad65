# Run at build time: writes the header OUTPUT with hashes of the library's sources under ROOT, so that stored results of
# one version of the code are never used by another version.

include(${CMAKE_CURRENT_LIST_DIR}/code_files.cmake)

# Sets `result` to the hash of all sources and headers of the components.
function(hash_components result)
  set(hashes "")
  loopwise_code_files(files ${ROOT} "" ${ARGN})
  foreach(file IN LISTS files)
    file(SHA256 ${ROOT}/${file} hash)
    string(APPEND hashes "${file} ${hash}\n")
  endforeach()
  string(SHA256 hash "${hashes}")
  string(SUBSTRING ${hash} 0 32 hash)
  set(${result} ${hash} PARENT_SCOPE)
endfunction()

hash_components(registration core features registration)
# Finished runs of studies contain figures from evaluation.
hash_components(replay core linalg features registration joining io generation optimization prioritization engine online replay evaluation)
file(WRITE ${OUTPUT} "#define LOOPWISE_REGISTRATION_CODE \"${registration}\"\n#define LOOPWISE_REPLAY_CODE \"${replay}\"\n")
