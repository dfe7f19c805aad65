# Doxygen's view of a public header: what the code says itself is said to Doxygen in its own form, line by line.
#   - The fields of an options struct get the text and the bounds of its visit(), their one description.
#   - visit() and enum_names(), which every options struct and enum has, get one sentence each.
#   - Destructors, and copies and moves that are deleted or as usual, are left out: there is nothing to say of them.
{ line[NR] = $0 }

# The pieces of text between quotes, joined.
function quoted(text,    result, at) {
  result = ""
  while ((at = match(text, /"([^"\\]|\\.)*"/)) > 0) {
    result = result substr(text, at + 1, RLENGTH - 2)
    text = substr(text, at + RLENGTH)
  }
  gsub(/\\"/, "\"", result)
  return result
}

# Bounds as they are written in visit(): "at_least(0.0)", "Bounds{0.0, 1.0, true}", "any_value()".
function bounds_text(code) {
  gsub(/[ \n]/, "", code)
  if (code ~ /^at_least\(/) return " ≥ " inside(code) "."
  if (code ~ /^above\(/) return " > " inside(code) "."
  if (code ~ /^between\(/) { sub(/,/, ", ", code); return " In [" inside(code) "]." }
  return ""
}
function inside(code) {
  sub(/^[a-z_]+\(/, "", code)
  sub(/\),?$/, "", code)
  return code
}

END {
  # First pass: descriptions by struct and field.
  for (i = 1; i <= NR; ++i) {
    if (match(line[i], /^(struct|class) [A-Za-z_ ]*/)) owner = type_name(line[i])
    if (line[i] !~ /^    field\(/) continue
    call = line[i]
    while (call !~ /\);$/ && i < NR) call = call " " line[++i]
    match(call, /"[a-z0-9_]+"/)
    name = substr(call, RSTART + 1, RLENGTH - 2)
    rest = substr(call, RSTART + RLENGTH + 1)
    sub(/^ *self\.[a-z0-9_]+, */, "", rest)
    match(rest, /^[^"]*/)
    bounds = substr(rest, 1, RLENGTH)
    doc[owner, name] = quoted(rest) bounds_text(bounds)
  }

  owner = ""
  for (i = 1; i <= NR; ++i) {
    text = line[i]
    if (match(text, /^(struct|class) [A-Za-z_ ]*/)) owner = type_name(text)
    commented = i > 1 && line[i - 1] ~ /^ *\/\/\//
    bare = text
    sub(/^ *(explicit |\[\[nodiscard\]\] )?/, "", bare)
    if (text ~ /^  [A-Za-z_:<>0-9]+ [a-z0-9_]+( = .*)?;/ && text !~ /\/\/\/</) {
      name = text
      sub(/( = .*)?;.*$/, "", name)
      sub(/^.* /, "", name)
      if ((owner, name) in doc) text = text "  ///< " doc[owner, name]
    } else if (text ~ /^  template <class Self, class Visitor>/ && line[i + 1] ~ / visit\(/) {
      text = "/** Describes the fields, see core/options.hpp. */" text
    } else if (text ~ /EnumNames<.*> enum_names\(/ && !commented) {
      text = "/** The words for the enumerators in files and on the command line. */" text
    } else if (bare ~ ("^~" owner "\\(") || bare ~ ("^virtual ~" owner "\\(") ||
               bare ~ ("^" owner "\\((const )?" owner "&&?\\)") || bare ~ ("^" owner "& operator=\\(")) {
      text = "/** \\cond */" text "/** \\endcond */"
    }
    print text
  }
}

function type_name(text) {
  sub(/^(struct|class) (LOOPWISE_EXPORT )?/, "", text)
  sub(/[^A-Za-z0-9_].*$/, "", text)
  return text
}
