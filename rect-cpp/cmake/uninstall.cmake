# Removes the files that the last `cmake --install` has written.
if(NOT EXISTS ${MANIFEST})
  message(FATAL_ERROR "nothing was installed from this build folder: ${MANIFEST} does not exist")
endif()
file(STRINGS ${MANIFEST} files)
foreach(file ${files})
  file(REMOVE "$ENV{DESTDIR}${file}")
  message(STATUS "removed $ENV{DESTDIR}${file}")
endforeach()
