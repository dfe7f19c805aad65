# The texts of options: the /// comments above the fields that visit() of an options struct names, see
# include/loopwise/core/options.hpp. Run at build time as
#   awk -v out=FILE -f option_texts.awk HEADERS...
# FILE gets a row {type, field, text} of a C++ table for each field. A field without a text is an error.

FNR == 1 { depth = 0; owner = ""; text = ""; in_call = 0 }

/^namespace .*\{$/ { scope[++depth] = $2 == "{" ? "" : $2 "::" }
/^\}  \/\/ namespace/ { --depth }

/^struct [A-Za-z0-9_ ]+/ {
  owner = $0
  sub(/^struct (LOOPWISE_EXPORT )?/, "", owner)
  sub(/[^A-Za-z0-9_].*$/, "", owner)
  for (i = depth; i > 0; --i) owner = scope[i] owner
}
/^\};/ { owner = "" }
owner == "" { next }

# A comment above a field, which may have several lines.
/^  \/\/\/ / {
  append(substr($0, 7))
  next
}
# A declaration, with the comment above it or after it.
/^  [A-Za-z_][A-Za-z0-9_:<>, ]* [a-z][a-z0-9_]*( =|;|\{)/ {
  match($0, /( =|;|\{)/)
  field = substr($0, 1, RSTART - 1)
  sub(/^.* /, "", field)
  if (match($0, /\/\/\/< /)) append(substr($0, RSTART + 5))
  texts[owner, field] = text
}
# A comment after a field may go on below.
/^ +\/\/\/< / {
  match($0, /\/\/\/< /)
  texts[owner, field] = texts[owner, field] " " substr($0, RSTART + 5)
}
!/^  \/\/\/$/ { text = "" }

# field("name", ...) in visit(); the name may stand on the next line.
/^ +field\(/ { in_call = 1 }
in_call && match($0, /"[a-z0-9_]+"/) {
  rows[++count] = owner SUBSEP substr($0, RSTART + 1, RLENGTH - 2)
  place[count] = FILENAME ":" FNR
  in_call = 0
}

function append(line) { text = text (text == "" ? "" : " ") line }

function quoted(string) {
  gsub(/["\\]/, "\\\\&", string)
  return "\"" string "\""
}

END {
  for (i = 1; i <= count; ++i) {
    split(rows[i], name, SUBSEP)
    if (texts[rows[i]] == "") {
      print place[i] ": " name[1] "::" name[2] " has no text: write a /// comment above the field" > "/dev/stderr"
      failed = 1
    }
    table = table "{" quoted(name[1]) ", " quoted(name[2]) ", " quoted(texts[rows[i]]) "},\n"
  }
  if (failed) exit 1
  printf "%s", table > out
}
