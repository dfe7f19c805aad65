# Run by the build: bundles WEB into OUT/report_template.cpp with NPM and NODE. If that fails, MODE=ON fails the build;
# MODE=AUTO warns and uses ABSENT, with which `loopwise report` states that it has no page.

function(give_up what output)
  # npm prints much; only the line with the error helps.
  string(REGEX MATCH "[^\n]*Error: [^\n]*" why "${output}")
  if(NOT why)
    string(SUBSTRING "${output}" 0 400 why)
  endif()
  string(CONCAT text "the page of `loopwise report` cannot be bundled: ${what}\n  ${why}\n"
    "npm needs its registry, or once what its cache then keeps (npm config set registry names another registry). "
    "To do without the page: cmake -DLOOPWISE_WITH_REPORT=OFF.")
  if(MODE STREQUAL "ON")
    message(FATAL_ERROR "${text}")
  endif()
  message(WARNING "${text} Going on without; to try again: cmake -DLOOPWISE_WITH_REPORT=ON.")
  configure_file(${ABSENT} ${OUT}/report_template.cpp COPYONLY)
  file(TOUCH ${OUT}/report_template.cpp)
endfunction()

# npm writes beside its package.json, so it runs on a copy and leaves the source tree unchanged.
set(work ${OUT}/work)
file(REMOVE_RECURSE ${work}/src)
file(COPY ${WEB}/package.json ${WEB}/package-lock.json ${WEB}/.npmrc ${WEB}/build.mjs ${WEB}/src DESTINATION ${work})

file(SHA256 ${WEB}/package-lock.json lock)
set(stamp ${work}/node_modules/.loopwise-lock)
set(installed "")
if(EXISTS ${stamp})
  file(READ ${stamp} installed)
endif()
if(NOT installed STREQUAL lock)
  execute_process(
    COMMAND ${NPM} ci --no-audit --no-fund --prefer-offline --loglevel=error --fetch-retries=1
            --fetch-retry-mintimeout=1000 --fetch-timeout=60000
    WORKING_DIRECTORY ${work} RESULT_VARIABLE status OUTPUT_QUIET ERROR_VARIABLE errors)
  if(NOT status EQUAL 0)
    give_up("npm ci failed" "${errors}")
    return()
  endif()
  file(WRITE ${stamp} ${lock})
endif()
execute_process(COMMAND ${NODE} build.mjs --out ${OUT}
  WORKING_DIRECTORY ${work} RESULT_VARIABLE status ERROR_VARIABLE errors)
if(NOT status EQUAL 0)
  give_up("node build.mjs failed" "${errors}")
endif()
