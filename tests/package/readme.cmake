# The C++ code of README is PROGRAM, which is built, without its licence line.
file(READ ${README} readme)
file(READ ${PROGRAM} program)
string(REGEX REPLACE "^[^\n]*\n" "" program "${program}")
string(FIND "${readme}" "${program}" place)
if(place EQUAL -1)
  message(FATAL_ERROR "${README} does not hold the text of ${PROGRAM}")
endif()
