# A project that finds the copy installed in PREFIX prints the texts of options of Loopwise and of its own.
cmake_minimum_required(VERSION 3.22)
file(WRITE ${FOLDER}/CMakeLists.txt [=[
cmake_minimum_required(VERSION 3.22)
project(describe LANGUAGES CXX)
find_package(loopwise CONFIG REQUIRED COMPONENTS io registration)
add_executable(describe describe.cpp)
target_link_libraries(describe PRIVATE loopwise::io loopwise::registration)
]=])
file(WRITE ${FOLDER}/describe.cpp [=[
#include <cstdio>

#include <loopwise/io/json_options.hpp>
#include <loopwise/registration/fast_registrar.hpp>

namespace station {
struct Options {
  double reach_m = 5.0;
  loopwise::FastRegistrarOptions registration;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("reach_m", self.reach_m, loopwise::above(0.0), "Reach of the radio, m.");
    loopwise::visit_part(self.registration, field);
  }
};
}  // namespace station

int main() {
  for (const auto& option : loopwise::describe(loopwise::FastRegistrarOptions())) {
    std::printf("%s: %s\n", option.name.c_str(), option.doc.c_str());
  }
  for (const auto& option : loopwise::describe(station::Options())) {
    std::printf("station %s: %s\n", option.name.c_str(), option.doc.c_str());
  }
}
]=])
file(REMOVE_RECURSE ${FOLDER}/build)
execute_process(COMMAND ${CMAKE_COMMAND} -S ${FOLDER} -B ${FOLDER}/build -G ${GENERATOR} -DCMAKE_CXX_COMPILER=${COMPILER}
                        -DCMAKE_CXX_COMPILER_LAUNCHER=${LAUNCHER} -DCMAKE_CXX_FLAGS=${FLAGS} -DCMAKE_PREFIX_PATH=${PREFIX}
                OUTPUT_QUIET COMMAND_ERROR_IS_FATAL ANY)
execute_process(COMMAND ${CMAKE_COMMAND} --build ${FOLDER}/build OUTPUT_QUIET COMMAND_ERROR_IS_FATAL ANY)
execute_process(COMMAND ${FOLDER}/build/describe OUTPUT_VARIABLE output COMMAND_ERROR_IS_FATAL ANY)
foreach(line "fpfh_radius_m: Radius of the FPFH descriptors, m." "min_points: Scans with fewer points are not aligned."
        "station reach_m: Reach of the radio, m." "station min_points: Scans with fewer points are not aligned.")
  string(FIND "\n${output}" "\n${line}\n" at)
  if(at EQUAL -1)
    message(FATAL_ERROR "\"${line}\" is missing in:\n${output}")
  endif()
endforeach()
