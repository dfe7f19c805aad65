# The C++ of the README is the program that is built: PROGRAM, its licence line left out, stands in README.
file(READ ${README} readme)
file(READ ${PROGRAM} program)
string(REGEX REPLACE "^[^\n]*\n" "" program "${program}")
string(FIND "${readme}" "${program}" place)
if(place EQUAL -1)
  message(FATAL_ERROR "${README} does not hold the text of ${PROGRAM}")
endif()
