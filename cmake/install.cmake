# `cmake --install`: headers, the libraries, the program, documents, pkg-config files, a CMake package; `cpack`: an archive of it.
include(CMakePackageConfigHelpers)

# Which symbols are exported, under which version (docs/abi.md).
if(BUILD_SHARED_LIBS)
  configure_file(${CMAKE_CURRENT_LIST_DIR}/libernerf.map.in ${PROJECT_BINARY_DIR}/libernerf.map @ONLY)
  configure_file(${CMAKE_CURRENT_LIST_DIR}/libernerf-media.map.in ${PROJECT_BINARY_DIR}/libernerf-media.map @ONLY)
  foreach(library ernerf ernerf-media)
    target_link_options(${library} PRIVATE -Wl,--version-script=${PROJECT_BINARY_DIR}/lib${library}.map)
    set_property(TARGET ${library} APPEND PROPERTY LINK_DEPENDS ${PROJECT_BINARY_DIR}/lib${library}.map)
  endforeach()
else()
  target_link_libraries(ernerf-media PRIVATE stdc++) # for programs in C
endif()

set_target_properties(ernerf ernerf-media PROPERTIES INSTALL_RPATH "$ORIGIN")
set_target_properties(ernerf-media PROPERTIES EXPORT_NAME media)
install(
  TARGETS ernerf ernerf-media ernerf-cli
  EXPORT ernerf-targets
  RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR}
  LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR}
  ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
foreach(library ernerf-media-impl ernerf-vision ernerf-perceptual ernerf-mpi ernerf-serve ernerf-webrtc) # loaded at run time by libernerf-media and the program; users do not link them
  if(TARGET ${library})
    set_target_properties(${library} PROPERTIES INSTALL_RPATH "$ORIGIN")
    install(TARGETS ${library} LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} NAMELINK_SKIP)
  endif()
endforeach()
if(TARGET ernerf-prepare)
  install(TARGETS ernerf-prepare EXPORT ernerf-targets LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR})
endif()
if(TARGET ernerf-probe-opencl) # started by libernerf, not by users
  install(TARGETS ernerf-probe-opencl RUNTIME DESTINATION ${CMAKE_INSTALL_LIBDIR}/ernerf)
endif()
if(ERNERF_OPENCL) # for a machine with a GPU and without a compiler
  install(PROGRAMS ${PROJECT_SOURCE_DIR}/tools/device-check DESTINATION ${CMAKE_INSTALL_DATADIR}/ernerf)
  install(FILES ${PROJECT_SOURCE_DIR}/tools/child.sh DESTINATION ${CMAKE_INSTALL_DATADIR}/ernerf)
endif()
install(DIRECTORY ${PROJECT_SOURCE_DIR}/include/ernerf DESTINATION ${CMAKE_INSTALL_INCLUDEDIR} FILES_MATCHING PATTERN *.h)

install(FILES ${PROJECT_SOURCE_DIR}/LICENSE ${PROJECT_SOURCE_DIR}/README.md ${PROJECT_SOURCE_DIR}/NEWS.md
        DESTINATION ${CMAKE_INSTALL_DOCDIR})
install(DIRECTORY ${PROJECT_SOURCE_DIR}/docs ${PROJECT_SOURCE_DIR}/examples DESTINATION ${CMAKE_INSTALL_DOCDIR})
install(DIRECTORY ${PROJECT_SOURCE_DIR}/data/tiny DESTINATION ${CMAKE_INSTALL_DATADIR}/ernerf) # an example clip

set(package_folder ${CMAKE_INSTALL_LIBDIR}/cmake/ernerf)
install(EXPORT ernerf-targets NAMESPACE ernerf:: DESTINATION ${package_folder})
configure_package_config_file(${CMAKE_CURRENT_LIST_DIR}/ernerf-config.cmake.in ${PROJECT_BINARY_DIR}/ernerf-config.cmake
                              INSTALL_DESTINATION ${package_folder})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/ernerf-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/ernerf-config.cmake ${PROJECT_BINARY_DIR}/ernerf-config-version.cmake
        DESTINATION ${package_folder})

# pkg-config: paths relative to the .pc file, so that an installed tree may be moved. A program that
# links a shared library needs none of its dependencies; one that links a static library needs all of them.
set(pc_folder ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
file(RELATIVE_PATH pc_prefix /prefix/${pc_folder} /prefix)
set(pc_engine_needs "")
set(pc_media_needs "")
set(pc_engine_libraries "")
set(pc_media_libraries "")
if(NOT BUILD_SHARED_LIBS)
  set(pc_engine_needs "jansson libzip")
  if(ERNERF_OPENCL)
    string(APPEND pc_engine_needs " OpenCL")
  endif()
  set(pc_engine_libraries "-lm -ldl -pthread")
  set(pc_media_needs ", libavformat libavcodec libavutil libswscale libswresample OpenImageIO")
  set(pc_media_libraries "-lopencv_imgproc -lopencv_core -lstdc++ -lm -pthread")
endif()
set(pc_names libernerf libernerf-media)
if(TARGET ernerf-prepare)
  list(APPEND pc_names libernerf-prepare)
endif()
foreach(library ${pc_names})
  configure_file(${CMAKE_CURRENT_LIST_DIR}/${library}.pc.in ${PROJECT_BINARY_DIR}/${library}.pc @ONLY)
  install(FILES ${PROJECT_BINARY_DIR}/${library}.pc DESTINATION ${pc_folder})
endforeach()

# A relocatable archive: it runs wherever it is unpacked, because libraries are found by $ORIGIN.
set(CPACK_GENERATOR TGZ)
set(CPACK_PACKAGE_NAME ernerf)
set(CPACK_PACKAGE_VENDOR ernerf)
set(CPACK_SYSTEM_NAME ${CMAKE_SYSTEM_NAME}-${CMAKE_SYSTEM_PROCESSOR})
set(CPACK_STRIP_FILES ON)
set(CPACK_VERBATIM_VARIABLES ON)
include(CPack)
